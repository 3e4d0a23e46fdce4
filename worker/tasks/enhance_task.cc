// ENHANCE: one window (ROI x frame range) -> window.pb and one raster per emitted scene.
#include <cmath>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "mosaic/raster/scene_raster.h"
#include "proto/codec/convert.h"
#include "worker/sortie/frame_reader.h"
#include "worker/tasks/engine_options_of.h"
#include "worker/tasks/pixel_use.h"
#include "worker/tasks/target_frames.h"
#include "worker/tasks/task.h"
#include "worker/tasks/task_inputs.h"
#include "worker/tre/mapping_engine.h"
#include "worker/tre/target_engine.h"

namespace trem {
namespace {

// Part of a window's progress that reading its frames takes, about.
constexpr double kReadingPart = 0.2;

Status CheckWindow(const v1::EnhanceParams& params, const v1::SortieManifest& manifest) {
  const Roi roi = FromProto(params.roi_in_sensor());
  const Roi sensor{0, 0, static_cast<int>(manifest.width_px()), static_cast<int>(manifest.height_px())};
  if (roi.empty() || !sensor.Contains(roi)) {
    return InvalidInput("ROI " + ToString(roi) + " is not inside the sensor " + ToString(sensor) + "; choose one that is");
  }
  if (params.frame_begin() >= params.frame_end() || params.frame_end() > static_cast<std::uint32_t>(manifest.frames_size())) {
    return InvalidInput("frames [" + std::to_string(params.frame_begin()) + ", " + std::to_string(params.frame_end()) +
                        ") are not a range of the sortie's " + std::to_string(manifest.frames_size()) + " frames");
  }
  if (!(manifest.grey_scale() > 0.0) || !std::isfinite(manifest.grey_offset())) return Corrupt("manifest.grey_scale is not positive");
  return {};
}

Result<std::vector<FrameInput>> ReadFrames(const v1::EnhanceParams& params, const v1::Sensor& sensor, const v1::SortieManifest& manifest,
                                           const TaskContext& context) {
  const Roi roi = FromProto(params.roi_in_sensor());
  TREM_ASSIGN_OR_RETURN(const std::unique_ptr<FrameReader> reader, OpenFrames(manifest));
  TREM_ASSIGN_OR_RETURN(const PixelUse pixel_use, PixelUse::Of(sensor, manifest));
  const bool masked = pixel_use.UsablePart(roi) < kUsablePartMin;
  std::vector<FrameInput> frames;
  for (std::uint32_t index = params.frame_begin(); index < params.frame_end(); ++index) {
    const double done = static_cast<double>(index - params.frame_begin()) / (params.frame_end() - params.frame_begin());
    if (!context.progress(kReadingPart * done)) return Cancelled("asked to stop");
    const v1::ManifestFrame& record = manifest.frames(static_cast<int>(index));
    FrameInput frame;
    frame.frame_index = static_cast<int>(index);
    if (record.state() != v1::FRAME_USABLE) {
      frame.skip_reason = UnusableReason(record.state());
    } else if (masked) {
      frame.skip_reason = "nearly all of the ROI is masked";
    } else {
      TREM_ASSIGN_OR_RETURN(const Image<float> whole, reader->Read(static_cast<int>(index)));
      pixel_use.Take(whole, roi, &frame);
    }
    TREM_ASSIGN_OR_RETURN(frame.previous_from_current, BelievedMotion(record));
    frames.push_back(std::move(frame));
  }
  return frames;
}

void AddChainView(const ChainEntry& entry, v1::Segment* segment) {
  v1::ChainView* view = segment->add_chain();
  view->set_frame_index(static_cast<std::uint32_t>(entry.frame_index));
  const Registration& registration = entry.registration;
  ToProto(registration.view.scene_from_sensor, view->mutable_scene_from_sensor());
  const Eigen::Index parameters = registration.corner_covariance.rows();
  for (Eigen::Index row = 0; row < parameters; ++row) {
    for (Eigen::Index column = row; column < parameters; ++column)
      view->add_corner_covariance_px2(registration.corner_covariance(row, column));
  }
  view->set_gain(registration.view.gain);
  view->set_offset(registration.view.offset);
  view->add_gain_offset_covariance(registration.gain_offset_covariance(0, 0));
  view->add_gain_offset_covariance(registration.gain_offset_covariance(0, 1));
  view->add_gain_offset_covariance(registration.gain_offset_covariance(1, 1));
  view->set_residual_rms(registration.residual_rms);
  view->set_correlation(registration.correlation);
  view->set_overlap(registration.overlap);
  if (entry.roi) *view->mutable_roi_in_sensor() = ToProto(*entry.roi);
}

v1::OutcomeCode CodeOf(FrameReport::Outcome outcome) {
  switch (outcome) {
    case FrameReport::Outcome::kRegistered:
      return v1::REGISTERED;
    case FrameReport::Outcome::kStartedScene:
      return v1::STARTED_SCENE;
    case FrameReport::Outcome::kSkipped:
      return v1::SKIPPED;
    case FrameReport::Outcome::kLost:
      break;
  }
  return v1::LOST;
}

// Writes snapshots as they are made and remembers them per segment.
class SnapshotWriter {
 public:
  explicit SnapshotWriter(const ArtefactStore& store) : store_(store) {}

  Status Write(int segment_id, const SceneSnapshot& snapshot) {
    const std::filesystem::path path = store_.NewTemporaryPath(".tif");
    TREM_RETURN_IF_ERROR(WriteSceneRaster(path, {snapshot.intensity, snapshot.information, snapshot.sigma, snapshot.residual, {}}));
    TREM_ASSIGN_OR_RETURN(const ArtefactRef ref, store_.PutFile("scene-" + std::to_string(snapshot.scene_id) + ".tif", path));
    v1::EmittedScene scene;
    scene.set_scene_id(static_cast<std::uint32_t>(snapshot.scene_id));
    *scene.mutable_raster() = ToProto(ref);
    *scene.mutable_roi_in_scene() = ToProto(snapshot.extent);
    scene.set_frame_begin(static_cast<std::uint32_t>(snapshot.frame_begin));
    scene.set_frame_end(static_cast<std::uint32_t>(snapshot.frame_end));
    scenes_.emplace_back(segment_id, std::move(scene));
    return {};
  }

  const std::vector<std::pair<int, v1::EmittedScene>>& scenes() const { return scenes_; }

 private:
  const ArtefactStore& store_;
  std::vector<std::pair<int, v1::EmittedScene>> scenes_;
};

v1::WindowResult MakeWindow(const v1::EnhanceParams& params, const EngineResult& engine, const SnapshotWriter& writer) {
  v1::WindowResult window;
  window.set_window_id(params.window_id());
  *window.mutable_roi_in_sensor() = params.roi_in_sensor();
  window.set_frame_begin(params.frame_begin());
  window.set_frame_end(params.frame_end());
  window.set_noise_sigma(engine.noise_sigma);
  for (std::size_t i = 0; i < engine.segments.size(); ++i) {
    v1::Segment* segment = window.add_segments();
    segment->set_segment_id(static_cast<std::uint32_t>(i));
    for (const ChainEntry& entry : engine.segments[i].chain) AddChainView(entry, segment);
    for (const auto& [segment_id, scene] : writer.scenes()) {
      if (segment_id == static_cast<int>(i)) *segment->add_scenes() = scene;
    }
  }
  for (const FrameReport& report : engine.frames) {
    v1::FrameOutcome* outcome = window.add_frames();
    outcome->set_frame_index(static_cast<std::uint32_t>(report.frame_index));
    outcome->set_outcome(CodeOf(report.outcome));
    outcome->set_reason(report.reason);
  }
  return window;
}

void AddNotes(const v1::EnhanceParams& params, const v1::SortieManifest& manifest, const EngineResult& engine, v1::TaskResult* result) {
  for (const EngineNote& found : engine.notes) {
    v1::Note* note = result->add_notes();
    note->set_code(found.code);
    const std::string window = "window " + std::to_string(params.window_id());
    note->set_subject(found.frame_index < 0 ? window : "frame " + manifest.frames(found.frame_index).name());
    note->set_message(found.frame_index < 0 ? found.text : "in " + window + ": " + found.text);
    note->set_severity(v1::INFO);
  }
}

Result<EngineResult> MapWindow(const v1::EnhanceParams& params, const v1::Sensor& sensor, const v1::SortieManifest& manifest,
                               const EngineOptions& options, const SnapshotSink& sink, const TaskContext& context) {
  TREM_ASSIGN_OR_RETURN(const std::vector<FrameInput> frames, ReadFrames(params, sensor, manifest, context));
  const auto progress = [&](double fraction) { return context.progress(kReadingPart + (1.0 - kReadingPart) * fraction); };
  return RunMapping(FromProto(params.roi_in_sensor()), frames, options, sink, progress);
}

Result<EngineResult> FollowTarget(const v1::EnhanceParams& params, const v1::Sensor& sensor, const v1::SortieManifest& manifest,
                                  const EngineOptions& options, const SnapshotSink& sink, const TaskContext& context) {
  TREM_ASSIGN_OR_RETURN(const std::unique_ptr<FrameReader> reader, OpenFrames(manifest));
  TREM_ASSIGN_OR_RETURN(const PixelUse pixel_use, PixelUse::Of(sensor, manifest));
  TargetFrameReader frames(manifest, static_cast<int>(params.frame_begin()), pixel_use, reader.get());
  TargetRequest request;
  request.roi_in_sensor = FromProto(params.roi_in_sensor());
  request.reference = static_cast<int>(params.target_picked_in_frame());
  request.frame_begin = static_cast<int>(params.frame_begin());
  request.frame_end = static_cast<int>(params.frame_end());
  request.sensor = {0, 0, static_cast<int>(manifest.width_px()), static_cast<int>(manifest.height_px())};
  return RunTarget(
      request, [&frames](int index) { return frames.Read(index); }, options, sink, context.progress);
}

}  // namespace

Result<v1::TaskResult> RunEnhanceTask(const v1::TaskSpec& spec, const TaskContext& context) {
  cv::setNumThreads(1);
  v1::SortieManifest manifest;
  // Of a job the manifest of the window's recording; see MergeRecordings.
  const bool is_part = !InputsNamed(spec, "recording.pb").empty();
  TREM_ASSIGN_OR_RETURN(const v1::ArtefactRef manifest_ref, SingleInput(spec, is_part ? "recording.pb" : "manifest.pb"));
  TREM_RETURN_IF_ERROR(ReadProtoArtefact(*context.store, manifest_ref, &manifest));
  TREM_RETURN_IF_ERROR(CheckWindow(spec.enhance(), manifest));
  SnapshotWriter writer(*context.store);
  const SnapshotSink sink = [&](int segment_id, const SceneSnapshot& snapshot) { return writer.Write(segment_id, snapshot); };
  EngineOptions options = EngineOptionsOf(spec, manifest);
  options.uncertainty = spec.enhance().uncertainty();
  options.threads = context.threads;
  const v1::Sensor& sensor = spec.sortie().sensor();
  Result<EngineResult> engine = spec.enhance().has_target_picked_in_frame()
                                    ? FollowTarget(spec.enhance(), sensor, manifest, options, sink, context)
                                    : MapWindow(spec.enhance(), sensor, manifest, options, sink, context);
  if (!engine.ok()) return engine.status().WithPrefix("window " + std::to_string(spec.enhance().window_id()));

  v1::TaskResult result;
  TREM_ASSIGN_OR_RETURN(const v1::ArtefactRef window_ref,
                        PutProtoArtefact(*context.store, "window.pb", MakeWindow(spec.enhance(), *engine, writer)));
  *result.add_outputs() = window_ref;
  AddNotes(spec.enhance(), manifest, *engine, &result);
  for (const auto& [segment_id, scene] : writer.scenes()) *result.add_outputs() = scene.raster();
  return result;
}

}  // namespace trem
