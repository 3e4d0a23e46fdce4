#include "worker/tasks/export_frames.h"

#include <utility>

#include "proto/codec/convert.h"
#include "worker/tasks/outcome_name.h"

namespace trem {
namespace {

// More would make the report unreadable; mosaic_chain.csv has all of them.
constexpr std::size_t kMissingFramesShown = 60;

// Why a frame that the manifest calls unusable is so.
std::string StateReason(v1::FrameState state) {
  switch (state) {
    case v1::FRAME_UNREADABLE:
      return "unreadable";
    case v1::FRAME_WRONG_SIZE:
      return "of another size";
    case v1::FRAME_BLANK:
      return "blank";
    case v1::FRAME_REPEATED:
      return "repeats the frame before";
    default:
      return "";
  }
}

Result<ChainFit> FitOf(const v1::ChainView& view, std::uint32_t segment_id) {
  ChainFit fit;
  fit.segment_id = segment_id;
  TREM_ASSIGN_OR_RETURN(fit.scene_from_sensor, PlanarMapFromProto(view.scene_from_sensor(), "ChainView.scene_from_sensor"));
  fit.gain = view.gain();
  fit.offset = view.offset();
  fit.residual_rms = view.residual_rms();
  fit.correlation = view.correlation();
  fit.overlap = view.overlap();
  return fit;
}

}  // namespace

Status FrameLedger::IndexAlignedFrames() {
  for (const v1::AlignedFrame& frame : alignment_.frames()) {
    TREM_ASSIGN_OR_RETURN(const Homography map, HomographyFromProto(frame.world_from_sensor(), "AlignedFrame.world_from_sensor"));
    // A frame in several pieces keeps the first: the alignment lists the better one first.
    world_from_sensor_.emplace(frame.frame_index(), map);
  }
  return {};
}

Result<ChainRow> FrameLedger::StartRow(std::uint32_t frame_index) const {
  if (frame_index >= static_cast<std::uint32_t>(manifest_.frames_size())) {
    return Corrupt("a window names frame " + std::to_string(frame_index) + "; the manifest has " + std::to_string(manifest_.frames_size()) +
                   " frames");
  }
  const v1::ManifestFrame& frame = manifest_.frames(static_cast<int>(frame_index));
  ChainRow row;
  row.frame_index = frame_index;
  row.frame_name = frame.name();
  row.time_s = frame.time_s();
  const auto aligned = world_from_sensor_.find(frame_index);
  if (aligned != world_from_sensor_.end()) row.world_from_sensor = aligned->second;
  return row;
}

Status FrameLedger::AddWindow(const v1::WindowResult& window, ChainCsvWriter* csv) {
  TREM_RETURN_IF_ERROR(AddEmittedScenes(window, &emitted_));
  std::map<std::uint32_t, ChainFit> fits;
  for (const v1::Segment& segment : window.segments()) {
    for (const v1::ChainView& view : segment.chain()) {
      TREM_ASSIGN_OR_RETURN(const ChainFit fit, FitOf(view, segment.segment_id()));
      fits.emplace(view.frame_index(), fit);
    }
    for (const v1::EmittedScene& scene : segment.scenes()) {
      scenes_[{window.window_id(), scene.scene_id()}] = {FromProto(window.roi_in_sensor()), scene.frame_begin(), scene.frame_end()};
    }
  }
  for (const v1::FrameOutcome& outcome : window.frames()) {
    TREM_ASSIGN_OR_RETURN(ChainRow row, StartRow(outcome.frame_index()));
    row.window_id = window.window_id();
    row.status = OutcomeName(outcome.outcome());
    row.reason = outcome.reason();
    const auto fit = fits.find(outcome.frame_index());
    if (fit != fits.end()) row.fit = fit->second;
    TREM_RETURN_IF_ERROR(csv->Write(row));

    const bool registered = outcome.outcome() == v1::REGISTERED || outcome.outcome() == v1::STARTED_SCENE;
    const Fate fate = registered ? Fate::kRegistered : outcome.outcome() == v1::SKIPPED ? Fate::kSkipped : Fate::kLost;
    FrameRecord& record = frames_[outcome.frame_index()];
    if (fate > record.fate) record = {fate, registered ? "" : outcome.reason()};
  }
  ++window_count_;
  return {};
}

Status FrameLedger::WriteUnusedFrames(ChainCsvWriter* csv) {
  for (std::uint32_t i = 0; i < frames_.size(); ++i) {
    FrameRecord& record = frames_[i];
    if (record.fate != Fate::kNotUsed) continue;
    const std::string state = StateReason(manifest_.frames(static_cast<int>(i)).state());
    if (!state.empty()) {
      record = {Fate::kSkipped, state};
    } else {
      record.reason = "in no window";
    }
    TREM_ASSIGN_OR_RETURN(ChainRow row, StartRow(i));
    row.status = state.empty() ? "not_used" : "skipped";
    row.reason = record.reason;
    TREM_RETURN_IF_ERROR(csv->Write(row));
  }
  return {};
}

Status FrameLedger::Gather(const ArtefactStore& store, const std::vector<v1::ArtefactRef>& windows, const std::filesystem::path& path,
                           const std::function<bool(double)>& progress) {
  frames_.assign(static_cast<std::size_t>(manifest_.frames_size()), FrameRecord{});
  TREM_RETURN_IF_ERROR(IndexAlignedFrames());
  TREM_ASSIGN_OR_RETURN(ChainCsvWriter csv, ChainCsvWriter::Create(path));
  for (std::size_t i = 0; i < windows.size(); ++i) {
    if (!progress(static_cast<double>(i) / static_cast<double>(windows.size()))) return Cancelled("the export was stopped");
    v1::WindowResult window;
    TREM_RETURN_IF_ERROR(ReadProtoArtefact(store, windows[i], &window));
    TREM_RETURN_IF_ERROR(AddWindow(window, &csv));
  }
  TREM_RETURN_IF_ERROR(WriteUnusedFrames(&csv));
  return csv.Close();
}

void FrameLedger::Summarise(ReportData* report) const {
  report->frame_count = static_cast<std::uint32_t>(frames_.size());
  report->window_count = window_count_;
  report->scene_count = static_cast<std::uint32_t>(alignment_.scenes_size());
  for (std::size_t i = 0; i < frames_.size(); ++i) {
    const char* status = "";
    switch (frames_[i].fate) {
      case Fate::kRegistered:
        ++report->registered_count;
        continue;
      case Fate::kSkipped:
        ++report->skipped_count;
        status = "not usable";
        break;
      case Fate::kLost:
        ++report->lost_count;
        status = "lost";
        break;
      case Fate::kNotUsed:
        ++report->not_used_count;
        status = "not used";
        break;
    }
    ++report->missing_frame_count;
    if (report->missing_frames.size() < kMissingFramesShown) {
      report->missing_frames.push_back({manifest_.frames(static_cast<int>(i)).name(), status, frames_[i].reason});
    }
  }
}

Result<std::vector<SceneFootprint>> FrameLedger::Footprints() const {
  std::vector<ArtefactRef> rasters;
  TREM_ASSIGN_OR_RETURN(const std::vector<CompositeScene> placed, PlacedScenes(alignment_, emitted_, &rasters));
  std::vector<SceneFootprint> footprints;
  footprints.reserve(placed.size());
  for (std::size_t i = 0; i < placed.size(); ++i) {
    const CompositeScene& scene = placed[i];
    const SceneRecord& record = scenes_.at({scene.window_id, scene.scene_id});
    SceneFootprint footprint;
    footprint.window_id = scene.window_id;
    footprint.scene_id = scene.scene_id;
    footprint.piece = alignment_.scenes(static_cast<int>(i)).piece();
    footprint.world_from_scene = scene.world_from_scene;
    footprint.raster_in_scene = scene.raster_in_scene;
    footprint.roi_in_sensor = record.roi_in_sensor;
    footprint.frame_begin = record.frame_begin;
    footprint.frame_end = record.frame_end;
    footprint.position_sigma = scene.position_sigma;
    footprint.gain = scene.gain;
    footprint.offset = scene.offset;
    footprints.push_back(footprint);
  }
  return footprints;
}

}  // namespace trem
