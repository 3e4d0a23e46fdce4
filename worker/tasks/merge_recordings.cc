#include "worker/tasks/merge_recordings.h"

#include <algorithm>
#include <string>

#include "mosaic/base/check.h"
#include "mosaic/geometry/roi.h"
#include "proto/codec/convert.h"
#include "worker/sortie/sortie_ground.h"

namespace trem {
namespace {

Status CheckAlike(const v1::SortieManifest& first, const v1::SortieManifest& other) {
  const auto describe = [](const v1::SortieManifest& m) {
    return std::to_string(m.width_px()) + " x " + std::to_string(m.height_px()) + " px with grey levels up to " +
           (m.grey_max() > 0.0 ? std::to_string(static_cast<int>(m.grey_max())) : std::string("any (floating point)"));
  };
  if (first.width_px() == other.width_px() && first.height_px() == other.height_px() && first.grey_max() == other.grey_max()) return {};
  return InvalidInput("recording " + other.source_path() + ": its frames are " + describe(other) + "; expected " + describe(first) +
                      ", as of " + first.source_path() + ": recordings of one mosaic come from one sensor");
}

// What ENHANCE reads, behind the frames of the recordings before it.
v1::SortieManifest PartOf(v1::SortieManifest recording, std::uint32_t frame_begin, const v1::RecordingManifest& place) {
  recording.clear_control();
  recording.clear_cutline();
  recording.clear_ground();
  recording.clear_ground_elevation_m();
  recording.clear_notes();
  recording.clear_telemetry_path();
  recording.clear_telemetry_summary();
  recording.clear_telemetry_source();
  recording.clear_valid_roi();
  recording.clear_spans();
  for (v1::ManifestFrame& frame : *recording.mutable_frames()) {
    frame.clear_pose();
    frame.clear_corner_lon_lat_deg();
    frame.clear_utc_us();
  }
  if (frame_begin == 0) return recording;
  google::protobuf::RepeatedPtrField<v1::ManifestFrame> frames;
  frames.Reserve(static_cast<int>(frame_begin) + recording.frames_size());
  for (std::uint32_t i = 0; i < frame_begin; ++i) frames.Add();
  for (v1::ManifestFrame& frame : *recording.mutable_frames()) *frames.Add() = std::move(frame);
  recording.mutable_frames()->Swap(&frames);
  *recording.add_recordings() = place;
  return recording;
}

void AppendTo(v1::SortieManifest* all, const v1::SortieManifest& recording) {
  const auto offset = static_cast<std::uint32_t>(all->frames_size());
  all->mutable_frames()->MergeFrom(recording.frames());
  for (v1::FrameSpan span : recording.spans()) {
    span.set_begin(span.begin() + offset);
    span.set_end(span.end() + offset);
    *all->add_spans() = span;
  }
  for (const v1::Note& note : recording.notes()) *all->add_notes() = note;
  *all->mutable_valid_roi() = ToProto(Intersect(FromProto(all->valid_roi()), FromProto(recording.valid_roi())));
}

}  // namespace

v1::Sortie SortieOfRecording(const v1::Sortie& sortie, int index) {
  v1::Sortie one = sortie;
  one.clear_more();
  if (index == 0) return one;
  *one.mutable_source() = sortie.more(index - 1).source();
  *one.mutable_telemetry() = sortie.more(index - 1).telemetry();
  // One ground under all of them.
  if (one.telemetry().dem_path().empty() && !one.telemetry().has_ground_elevation_m()) {
    if (sortie.telemetry().has_ground_elevation_m())
      one.mutable_telemetry()->set_ground_elevation_m(sortie.telemetry().ground_elevation_m());
    one.mutable_telemetry()->set_dem_path(sortie.telemetry().dem_path());
  }
  // Its points name frames of the first recording.
  one.clear_control();
  return one;
}

Result<MergedRecordings> MergeRecordings(const v1::Sortie& sortie, const std::vector<v1::SortieManifest>& recordings) {
  TREM_CHECK(!recordings.empty());
  MergedRecordings merged;
  std::vector<v1::RecordingManifest> places;
  std::uint32_t frame_begin = 0;
  for (std::size_t k = 0; k < recordings.size(); ++k) {
    const v1::SortieManifest& recording = recordings[k];
    TREM_RETURN_IF_ERROR(CheckAlike(recordings.front(), recording));
    const v1::Telemetry telemetry = SortieOfRecording(sortie, static_cast<int>(k)).telemetry();
    v1::RecordingManifest place;
    place.set_source_path(recording.source_path());
    place.set_source_kind(recording.source_kind());
    place.set_frame_begin(frame_begin);
    place.set_frame_end(frame_begin + static_cast<std::uint32_t>(recording.frames_size()));
    place.set_grey_offset(recording.grey_offset());
    place.set_grey_scale(recording.grey_scale());
    place.set_deinterlaced(recording.deinterlaced());
    place.set_video_from_start(recording.video_from_start());
    place.set_position_sigma_m(telemetry.position_sigma_m() > 0.0 ? telemetry.position_sigma_m() : 1.0);
    place.set_attitude_sigma_deg(telemetry.attitude_sigma_deg() > 0.0 ? telemetry.attitude_sigma_deg() : 0.1);
    merged.parts.push_back(PartOf(recording, frame_begin, place));
    places.push_back(place);
    frame_begin = place.frame_end();
  }
  merged.all = recordings.front();
  if (recordings.size() == 1) return merged;
  for (std::size_t k = 1; k < recordings.size(); ++k) AppendTo(&merged.all, recordings[k]);
  for (const v1::RecordingManifest& place : places) *merged.all.add_recordings() = place;
  if (FromProto(merged.all.valid_roi()).empty())
    return InvalidInput("the recordings' pictures without their black borders have nothing in common");
  // The elevation model is cut to what all of them see.
  const std::string& dem_path = sortie.telemetry().dem_path();
  if (!dem_path.empty()) {
    merged.all.clear_ground();
    TREM_RETURN_IF_ERROR(AttachGround(dem_path, &merged.all));
  }
  return merged;
}

}  // namespace trem
