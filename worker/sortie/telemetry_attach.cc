#include "worker/sortie/telemetry_attach.h"

#include <fmt/format.h>

#include <cmath>
#include <numbers>

#include "mosaic/geometry/camera.h"
#include "mosaic/geometry/ground_surface.h"
#include "mosaic/raster/crs.h"
#include "proto/codec/convert.h"
#include "worker/sortie/frame_source.h"
#include "worker/sortie/sortie_ground.h"
#include "worker/sortie/telemetry_match.h"
#include "worker/telemetry/telemetry_track.h"
#include "worker/telemetry/time_offset.h"

namespace trem {
namespace {

constexpr double kRad = std::numbers::pi / 180.0;
// As telemetry.attitude_sigma_deg defaults to.
constexpr double kAttitudeSigma_deg = 0.1;
constexpr int kWanderHalfWindow = 64;
constexpr double kGroundSpread_m = 50.0;
// Pixels whose sides differ by less do no harm that shows.
constexpr double kSquareTolerance = 0.03;

class Attacher {
 public:
  Attacher(const FoundTelemetry& found, const v1::Telemetry& spec, v1::SortieManifest* manifest)
      : found_(found), spec_(spec), manifest_(*manifest), track_(WithHorizontalField(found.audit.poses)) {}

  Status Run() {
    ShiftToFrames();
    SetOffset();
    SetWander();
    int posed = 0;
    int cornered = 0;
    int interpolated = 0;
    for (int i = 0; i < manifest_.frames_size(); ++i) {
      v1::ManifestFrame& frame = *manifest_.mutable_frames(i);
      const double time_s = frame.time_s() + zero_s_;
      const std::optional<std::int64_t> utc_us = found_.utc.At(time_s);
      if (utc_us.has_value()) frame.set_utc_us(*utc_us);
      std::optional<TrackPose> pose = track_.At(time_s);
      if (pose.has_value()) {
        if (!pointing_errors_px_.empty()) {
          pose->camera = Repointed(pose->camera, pointing_errors_px_[static_cast<std::size_t>(i)], Geometry());
        }
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
    NoteGround();
    return ReplacePosesByCorners();
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

  std::vector<CameraSample> WithHorizontalField(std::vector<CameraSample> samples) const {
    const double aspect = static_cast<double>(manifest_.width_px()) / manifest_.height_px();
    for (CameraSample& sample : samples) {
      if (!sample.hfov_deg.has_value()) sample.hfov_deg = 2.0 * std::atan(aspect * std::tan(0.5 * *sample.vfov_deg * kRad)) / kRad;
    }
    return samples;
  }

  void SetOffset() {
    if (spec_.has_time_offset_s()) {
      zero_s_ += spec_.time_offset_s();
      Note(v1::INFO, "time_offset",
           fmt::format("frames show what the telemetry says {:+.3f} s later, as asked for", spec_.time_offset_s()));
      return;
    }
    if (track_.empty()) return;
    TimeOffsetOptions options;
    options.geometry = Geometry();
    const TimeOffset offset = EstimateTimeOffset(track_, Motions(), options);
    if (!offset.determined) {
      Note(v1::INFO, "time_offset_not_estimated", "no offset between telemetry and frames is applied: " + offset.reason);
      return;
    }
    zero_s_ += offset.offset_s;
    Note(v1::INFO, "time_offset",
         fmt::format(
             "frames show what the telemetry says {:+.3f} +- {:.3f} s later: with that it predicts the motion of {} frames to {:.2f} px, "
             "without to {:.2f} px; applied",
             offset.offset_s, offset.sigma_s, offset.pairs, offset.rms_px, offset.rms_at_zero_px));
  }

  MotionGeometry Geometry() const {
    return {static_cast<int>(manifest_.width_px()), static_cast<int>(manifest_.height_px()), found_.audit.ground_elevation_m};
  }

  // Poses that run away from what the images show are turned after them: held to the poses frame by frame, the alignment would follow some
  // of them and take the images for outliers.
  void SetWander() {
    if (track_.empty()) return;
    std::vector<MeasuredLink> links;
    std::vector<std::size_t> frame_of_link;
    for (int i = 0; i < manifest_.frames_size(); ++i) {
      const v1::ManifestFrame& frame = manifest_.frames(i);
      if (frame.state() != v1::FRAME_USABLE) continue;
      frame_of_link.push_back(static_cast<std::size_t>(i));
      MeasuredLink link{frame.time_s() + zero_s_, std::nullopt};
      const Result<Affine> motion = AffineFromProto(frame.previous_from_current(), "previous_from_current");
      if (frame.motion_correlation() > 0.0 && motion.ok()) link.previous_from_current = *motion;
      links.push_back(link);
    }
    const std::optional<PoseWander> wander = MeasureWander(track_, links, Geometry());
    const double believed_deg = spec_.attitude_sigma_deg() > 0.0 ? spec_.attitude_sigma_deg() : kAttitudeSigma_deg;
    if (!wander.has_value() || wander->rms_deg <= believed_deg) return;
    wander_deg_ = wander->rms_deg;
    const std::vector<Eigen::Vector2d> errors = PointingErrors(track_, links, Geometry(), kWanderHalfWindow);
    pointing_errors_px_.assign(static_cast<std::size_t>(manifest_.frames_size()), Eigen::Vector2d::Zero());
    for (std::size_t i = 0; i < links.size(); ++i) pointing_errors_px_[frame_of_link[i]] = errors[i];
    Note(v1::WARNING, "telemetry_wanders",
         fmt::format(
             "the poses run away from what the images show: within runs of up to 64 frames the image centre is where they say to "
             "{:.1f} px rms, {:.2f} degrees seen from the camera (telemetry.attitude_sigma_deg: {:.2f}). They are turned to follow the "
             "images from frame to frame, keeping their average over {} frames; the mosaic's absolute place may be off by as much",
             wander->rms_px, wander->rms_deg, believed_deg, 2 * kWanderHalfWindow));
  }

  std::vector<MeasuredMotion> Motions() const {
    std::vector<MeasuredMotion> motions;
    const Eigen::Vector2d middle(0.5 * (manifest_.width_px() - 1.0), 0.5 * (manifest_.height_px() - 1.0));
    const v1::ManifestFrame* previous = nullptr;
    for (const v1::ManifestFrame& frame : manifest_.frames()) {
      if (frame.state() != v1::FRAME_USABLE) continue;
      const Result<Affine> motion = AffineFromProto(frame.previous_from_current(), "previous_from_current");
      if (previous != nullptr && frame.motion_correlation() > 0.0 && motion.ok()) {
        motions.push_back({previous->time_s() + zero_s_, frame.time_s() + zero_s_, *motion * middle - middle});
      }
      previous = &frame;
    }
    return motions;
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
    pose.set_hfov_deg(*camera.hfov_deg);
    pose.set_position_sigma_m(sample.uncertainty.position_m);
    pose.set_attitude_sigma_deg(std::hypot(sample.uncertainty.attitude_deg, wander_deg_));
    return pose;
  }

  // How many times as high as wide the pixels are by the fields of view; 1 where only one is stated.
  double PixelHeight() const {
    for (const CameraSample& camera : track_.samples()) {
      if (!camera.vfov_deg.has_value()) continue;
      const double stated = std::tan(0.5 * *camera.hfov_deg * kRad) / std::tan(0.5 * *camera.vfov_deg * kRad);
      return static_cast<double>(manifest_.width_px()) / manifest_.height_px() / stated;
    }
    return 1.0;
  }

  // The alignment's camera has square pixels. Frames of others get the ground under their corners, which fits any projective map.
  Status ReplacePosesByCorners() {
    const double high = PixelHeight();
    if (std::abs(high - 1.0) <= kSquareTolerance) return {};
    int replaced = 0;
    for (v1::ManifestFrame& frame : *manifest_.mutable_frames()) {
      if (!frame.has_pose()) continue;
      TREM_ASSIGN_OR_RETURN(const bool seen, SetCornersOfPose(high, &frame));
      if (!seen) continue;
      frame.clear_pose();
      ++replaced;
    }
    Note(v1::INFO, "pixels_not_square",
         fmt::format(
             "the fields of view make the pixels {:.3f} times as high as wide: {} frames get the ground under their corners, computed "
             "from their poses and both fields of view, instead of poses",
             high, replaced));
    return {};
  }

  // False when a corner sees no ground.
  Result<bool> SetCornersOfPose(double pixel_height, v1::ManifestFrame* frame) const {
    const v1::Pose& pose = frame->pose();
    TREM_ASSIGN_OR_RETURN(const UtmFrame map, UtmFrame::ForPoint(pose.latitude_deg(), pose.longitude_deg()));
    TREM_ASSIGN_OR_RETURN(const Eigen::Vector2d at, map.Forward(pose.latitude_deg(), pose.longitude_deg()));
    TREM_ASSIGN_OR_RETURN(const double scale, map.ScaleFactor(pose.latitude_deg(), pose.longitude_deg()));
    TREM_ASSIGN_OR_RETURN(const double convergence_rad, map.ConvergenceRad(pose.latitude_deg(), pose.longitude_deg()));
    const Eigen::Matrix3d world_from_camera =
        WorldFromCamera(pose.yaw_deg() * kRad - convergence_rad, pose.pitch_deg() * kRad, pose.roll_deg() * kRad);
    const double right = std::tan(0.5 * pose.hfov_deg() * kRad);
    const double down = right * pixel_height * manifest_.height_px() / manifest_.width_px();
    const LevelGround ground(found_.audit.ground_elevation_m);
    std::array<double, 8> lon_lat_deg{};
    constexpr std::array<std::array<double, 2>, 4> kSigns = {{{-1, -1}, {1, -1}, {1, 1}, {-1, 1}}};
    for (std::size_t k = 0; k < 4; ++k) {
      const Eigen::Vector3d ray = world_from_camera * Eigen::Vector3d(kSigns[k][0] * right, kSigns[k][1] * down, 1.0);
      const std::optional<Eigen::Vector3d> x = IntersectSurface({0.0, 0.0, pose.altitude_m()}, ray, ground);
      if (!x.has_value()) return false;
      TREM_ASSIGN_OR_RETURN(const Eigen::Vector2d place, map.Inverse(at + scale * x->head<2>()));
      lon_lat_deg[2 * k] = place.y();
      lon_lat_deg[2 * k + 1] = place.x();
    }
    frame->clear_corner_lon_lat_deg();
    for (const double number : lon_lat_deg) frame->add_corner_lon_lat_deg(number);
    return true;
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
  const v1::Telemetry& spec_;
  v1::SortieManifest& manifest_;
  TelemetryTrack track_;
  double zero_s_ = 0.0;
  double wander_deg_ = 0.0;
  std::vector<Eigen::Vector2d> pointing_errors_px_;  // By frame; empty: the poses are kept as they are.
};

// Photographs turned by a viewer keep the angles of their camera: where the images move the other way than the poses say, the poses are
// rolled.
void TurnWithPictures(const std::string& path, v1::SortieManifest* manifest) {
  std::vector<CameraSample> samples;
  std::vector<MeasuredLink> links;
  // Numbers of frames stand for times.
  for (int i = 0; i < manifest->frames_size(); ++i) {
    const v1::ManifestFrame& frame = manifest->frames(i);
    if (frame.state() != v1::FRAME_USABLE || !frame.has_pose()) continue;
    const v1::Pose& pose = frame.pose();
    samples.push_back({static_cast<double>(i), pose.latitude_deg(), pose.longitude_deg(), pose.altitude_m(), pose.yaw_deg(),
                       pose.pitch_deg(), pose.roll_deg(), pose.hfov_deg(), std::nullopt});
    MeasuredLink link{static_cast<double>(i), std::nullopt};
    const Result<Affine> motion = AffineFromProto(frame.previous_from_current(), "previous_from_current");
    if (frame.motion_correlation() > 0.0 && motion.ok()) link.previous_from_current = *motion;
    links.push_back(link);
  }
  const MotionGeometry geometry{static_cast<int>(manifest->width_px()), static_cast<int>(manifest->height_px()),
                                manifest->ground_elevation_m()};
  const std::optional<PictureTurn> turn = MeasureTurn(TelemetryTrack(samples), links, geometry);
  if (!turn.has_value() || turn->quarter_turns == 0) return;
  for (v1::ManifestFrame& frame : *manifest->mutable_frames()) {
    if (!frame.has_pose()) continue;
    frame.mutable_pose()->set_roll_deg(std::remainder(frame.pose().roll_deg() - 90.0 * turn->quarter_turns, 360.0));
  }
  *manifest->add_notes() = MakeNote(
      v1::WARNING, "pictures_turned", path,
      fmt::format("the images of {} pairs move {:.0f} degrees away from where their poses say: the pictures are taken to be turned by "
                  "{} degrees against the camera, and the poses are rolled by that",
                  turn->pairs, turn->degrees, 90 * turn->quarter_turns));
}

}  // namespace

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
  if (found.table.has_value()) {
    TREM_RETURN_IF_ERROR(AttachTelemetry(*found.table, found.path, sortie.telemetry(), manifest));
  } else {
    TREM_RETURN_IF_ERROR(Attacher(found, sortie.telemetry(), manifest).Run());
  }
  const bool from_camera = found.source == v1::TELEMETRY_EXIF || found.source == v1::TELEMETRY_SRT || found.source == v1::TELEMETRY_GPX;
  if (from_camera) TurnWithPictures(found.path, manifest);
  manifest->set_telemetry_source(found.source);
  manifest->set_telemetry_path(found.path);
  manifest->set_telemetry_summary(found.audit.explanation);
  return sortie.telemetry().dem_path().empty() ? Status() : AttachGround(sortie.telemetry().dem_path(), manifest);
}

}  // namespace trem
