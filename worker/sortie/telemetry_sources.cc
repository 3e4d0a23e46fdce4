#include "worker/sortie/telemetry_sources.h"

#include <fmt/format.h>

#include <cmath>
#include <filesystem>
#include <numbers>

#include "worker/sortie/frame_source.h"
#include "worker/sortie/image_sequence_reader.h"
#include "worker/sortie/klv_telemetry.h"
#include "worker/sortie/telemetry_match.h"
#include "worker/telemetry/telemetry_track.h"

namespace trem {
namespace {

constexpr double kRad = std::numbers::pi / 180.0;
constexpr double kGroundSpread_m = 50.0;
// Pixels whose sides differ by less do no harm that shows.
constexpr double kSquareTolerance = 0.03;

bool IsVideo(const v1::Sortie& sortie) {
  std::error_code error;
  const std::string& path = sortie.source().path();
  return std::filesystem::is_regular_file(path, error) && !HasImageExtension(path);
}

AuditOptions OptionsOf(const v1::Sortie& sortie, double aspect) {
  AuditOptions options;
  options.aspect = aspect;
  if (sortie.telemetry().has_ground_elevation_m()) options.ground_elevation_m = sortie.telemetry().ground_elevation_m();
  return options;
}

class Attacher {
 public:
  Attacher(const FoundTelemetry& found, v1::SortieManifest* manifest) : found_(found), manifest_(*manifest), track_(found.audit.poses) {}

  void Run() {
    ShiftToFrames();
    int posed = 0;
    int cornered = 0;
    int interpolated = 0;
    for (v1::ManifestFrame& frame : *manifest_.mutable_frames()) {
      const double time_s = frame.time_s() + zero_s_;
      const std::optional<TrackPose> pose = track_.At(time_s);
      if (pose.has_value()) {
        *frame.mutable_pose() = ToPose(*pose);
        ++posed;
        interpolated += pose->interpolated ? 1 : 0;
      }
      const std::optional<std::array<GeoPoint, 4>> corners = CornersAt(found_.audit.corners, time_s);
      if (!corners.has_value()) continue;
      ++cornered;
      for (const GeoPoint& corner : *corners) {
        frame.add_corner_lon_lat_deg(corner.longitude_deg);
        frame.add_corner_lon_lat_deg(corner.latitude_deg);
      }
    }
    const int frames = manifest_.frames_size();
    if (interpolated > 0) {
      Note(v1::INFO, "poses_interpolated",
           fmt::format("poses of {} of {} frames are interpolated between records {:.3g} s apart", interpolated, frames,
                       track_.interval_s()));
    }
    const int placed = std::max(posed, cornered);
    if (placed < frames) {
      Note(placed == 0 ? v1::WARNING : v1::INFO, "frames_without_telemetry",
           fmt::format("{} of {} frames lie in gaps of the telemetry of more than {:g} s or beyond its ends", frames - placed, frames,
                       kTrackGap_s));
    }
    NotePixelShape();
    NoteGround();
  }

 private:
  void Note(v1::Severity severity, const std::string& code, const std::string& message) {
    *manifest_.add_notes() = MakeNote(severity, code, found_.path, message);
  }

  // Finds what time 0 of the frames is on the telemetry's clock.
  void ShiftToFrames() {
    if (found_.time_base_s <= 0.0 || manifest_.frames_size() == 0) return;
    zero_s_ = static_cast<double>(manifest_.frames(0).pts()) * found_.time_base_s - manifest_.frames(0).time_s();
  }

  v1::Pose ToPose(const TrackPose& sample) const {
    const CameraSample& camera = sample.camera;
    v1::Pose pose;
    pose.set_latitude_deg(camera.latitude_deg);
    pose.set_longitude_deg(camera.longitude_deg);
    pose.set_altitude_m(camera.altitude_m);
    pose.set_yaw_deg(camera.yaw_deg);
    pose.set_pitch_deg(camera.pitch_deg);
    pose.set_roll_deg(camera.roll_deg);
    const double aspect = static_cast<double>(manifest_.width_px()) / manifest_.height_px();
    pose.set_hfov_deg(camera.hfov_deg.has_value() ? *camera.hfov_deg
                                                  : 2.0 * std::atan(aspect * std::tan(0.5 * camera.vfov_deg.value_or(0.0) * kRad)) / kRad);
    pose.set_position_sigma_m(sample.uncertainty.position_m);
    pose.set_attitude_sigma_deg(sample.uncertainty.attitude_deg);
    return pose;
  }

  void NotePixelShape() {
    for (const CameraSample& camera : track_.samples()) {
      if (!camera.hfov_deg.has_value() || !camera.vfov_deg.has_value()) continue;
      const double stated = std::tan(0.5 * *camera.hfov_deg * kRad) / std::tan(0.5 * *camera.vfov_deg * kRad);
      const double high = static_cast<double>(manifest_.width_px()) / manifest_.height_px() / stated;
      if (std::abs(high - 1.0) > kSquareTolerance) {
        Note(v1::WARNING, "pixels_not_square",
             fmt::format(
                 "a field of view of {:g} x {:g} degrees on {} x {} pixels makes pixels {:.3f} times as high as wide; square ones of the "
                 "horizontal field of view are assumed",
                 *camera.hfov_deg, *camera.vfov_deg, manifest_.width_px(), manifest_.height_px(), high));
      }
      return;
    }
  }

  void NoteGround() {
    manifest_.set_ground_elevation_m(found_.audit.ground_elevation_m);
    if (found_.audit.poses.empty()) return;
    if (found_.audit.ground_spread_m > kGroundSpread_m) {
      Note(v1::WARNING, "ground_not_level",
           fmt::format("the stated elevation of the ground varies by {:.0f} m; its median, {:.1f} m, is used for all frames",
                       found_.audit.ground_spread_m, found_.audit.ground_elevation_m));
    }
    if (!found_.audit.ground_known) {
      Note(v1::INFO, "ground_elevation_assumed",
           "nothing tells the elevation of the ground and telemetry.ground_elevation_m is not set: 0 m is assumed");
    }
  }

  const FoundTelemetry& found_;
  v1::SortieManifest& manifest_;
  TelemetryTrack track_;
  double zero_s_ = 0.0;
};

// Takes the audit's verdict over: poses or corners are used, or a note says why not.
void Judge(TelemetryAudit audit, v1::TelemetrySource source, const std::string& path, FoundTelemetry* found) {
  for (const std::string& doubt : audit.doubts) found->notes.push_back(MakeNote(v1::WARNING, "telemetry_suspicious", path, doubt));
  if (audit.verdict == AuditVerdict::kRefused) {
    found->notes.push_back(MakeNote(v1::WARNING, "telemetry_refused", path, "the telemetry is not used: " + audit.explanation));
    return;
  }
  const bool corners = audit.verdict == AuditVerdict::kCorners;
  found->notes.push_back(
      MakeNote(corners ? v1::WARNING : v1::INFO, corners ? "telemetry_corners_only" : "telemetry_convention", path, audit.explanation));
  found->source = source;
  found->path = path;
  found->audit = std::move(audit);
}

Status FindKlv(const v1::Sortie& sortie, double aspect, FoundTelemetry* found) {
  const std::string& path = sortie.source().path();
  Result<KlvTelemetry> klv = ReadKlvTelemetry(path);
  // What cannot be opened is the frame reader's to report.
  if (!klv.ok()) return {};
  found->notes.insert(found->notes.end(), klv->notes.begin(), klv->notes.end());
  if (klv->chosen < 0) return {};
  const KlvStreamContent& content = klv->streams[klv->chosen];
  found->time_base_s = content.counts_from_first ? 0.0 : klv->time_base_s;
  Judge(AuditTelemetry(content.records, OptionsOf(sortie, aspect)), v1::TELEMETRY_KLV, path, found);
  return {};
}

}  // namespace

Result<FoundTelemetry> FindTelemetry(const v1::Sortie& sortie, double aspect) {
  FoundTelemetry found;
  if (sortie.telemetry().ignore()) return found;
  const std::optional<std::string> csv = FindTelemetryCsv(sortie);
  if (csv.has_value()) {
    TREM_ASSIGN_OR_RETURN(found.table, ReadTelemetryCsv(*csv));
    found.source = v1::TELEMETRY_CSV;
    found.path = *csv;
    return found;
  }
  if (IsVideo(sortie)) TREM_RETURN_IF_ERROR(FindKlv(sortie, aspect, &found));
  return found;
}

Status AttachFoundTelemetry(const FoundTelemetry& found, const v1::Sortie& sortie, v1::SortieManifest* manifest) {
  for (const v1::Note& note : found.notes) *manifest->add_notes() = note;
  if (found.source == v1::TELEMETRY_NONE) {
    manifest->set_ground_elevation_m(sortie.telemetry().ground_elevation_m());
    *manifest->add_notes() =
        MakeNote(v1::INFO, "no_telemetry", sortie.source().path(),
                 sortie.telemetry().ignore() ? "telemetry is ignored as asked for; the mosaic will be in local coordinates"
                 : found.notes.empty()       ? "no telemetry was found; the mosaic will be in local coordinates"
                                             : "no usable telemetry was found; the mosaic will be in local coordinates");
    return {};
  }
  if (found.table.has_value()) return AttachTelemetry(*found.table, found.path, sortie.telemetry(), manifest);
  manifest->set_telemetry_source(found.source);
  manifest->set_telemetry_path(found.path);
  manifest->set_telemetry_summary(found.audit.explanation);
  Attacher(found, manifest).Run();
  return {};
}

}  // namespace trem
