#include "worker/telemetry/predicted_motion.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "mosaic/geometry/camera.h"
#include "worker/telemetry/audit_geometry.h"

namespace trem {
namespace {

constexpr double kRad = std::numbers::pi / 180.0;
constexpr double kMetresPerDegree = 111320.0;
constexpr int kFramesMin = 8;

}  // namespace

std::optional<Homography> GroundFromFrameAt(const TelemetryTrack& track, double time_s, const MotionGeometry& geometry) {
  const std::optional<TrackPose> pose = track.At(time_s);
  if (!pose.has_value() || !pose->camera.hfov_deg.has_value()) return std::nullopt;
  const CameraSample& c = pose->camera;
  const CameraSample& origin = track.samples().front();
  if (!(c.altitude_m > geometry.ground_elevation_m)) return std::nullopt;
  CameraPose camera;
  camera.position_m << std::remainder(c.longitude_deg - origin.longitude_deg, 360.0) * kMetresPerDegree *
                           std::cos(origin.latitude_deg * kRad),
      (c.latitude_deg - origin.latitude_deg) * kMetresPerDegree, c.altitude_m;
  camera.yaw_rad = c.yaw_deg * kRad;
  camera.pitch_rad = c.pitch_deg * kRad;
  camera.roll_rad = c.roll_deg * kRad;
  const CameraIntrinsics intrinsics{geometry.width_px, geometry.height_px, FocalFromHorizontalFov(geometry.width_px, *c.hfov_deg * kRad)};
  const Homography ground_from_frame = GroundFromSensor(camera, intrinsics, geometry.ground_elevation_m);
  if (ground_from_frame.Depth(geometry.middle()) <= 1e-6) return std::nullopt;
  return ground_from_frame;
}

std::optional<PictureTurn> MeasureTurn(const TelemetryTrack& track, const std::vector<MeasuredLink>& links,
                                       const MotionGeometry& geometry) {
  constexpr double kLeastShift = 0.05;
  constexpr double kNear_deg = 20.0;
  std::vector<double> turns_deg;
  for (std::size_t i = 1; i < links.size(); ++i) {
    if (!links[i].previous_from_current.has_value()) continue;
    const std::optional<Homography> now = GroundFromFrameAt(track, links[i].time_s, geometry);
    const std::optional<Homography> before = GroundFromFrameAt(track, links[i - 1].time_s, geometry);
    if (!now.has_value() || !before.has_value()) continue;
    const Eigen::Vector2d predicted = before->Inverse() * (*now * geometry.middle()) - geometry.middle();
    const Eigen::Vector2d measured = *links[i].previous_from_current * geometry.middle() - geometry.middle();
    const double ratio = measured.norm() / std::max(1e-9, predicted.norm());
    if (predicted.norm() < kLeastShift * geometry.width_px || ratio < 0.5 || ratio > 2.0) continue;
    turns_deg.push_back(
        std::remainder(std::atan2(measured.y(), measured.x()) - std::atan2(predicted.y(), predicted.x()), 2.0 * std::numbers::pi) / kRad);
  }
  for (const int quarters : {0, 2, 1, -1}) {
    std::vector<double> near_deg;
    for (const double turn_deg : turns_deg) {
      const double off_deg = std::remainder(turn_deg - 90.0 * quarters, 360.0);
      if (std::abs(off_deg) <= kNear_deg) near_deg.push_back(90.0 * quarters + off_deg);
    }
    if (near_deg.size() < 2 || 10 * near_deg.size() < 8 * turns_deg.size()) continue;
    const auto middle = near_deg.begin() + static_cast<std::ptrdiff_t>(near_deg.size() / 2);
    std::nth_element(near_deg.begin(), middle, near_deg.end());
    return PictureTurn{quarters, *middle, static_cast<int>(near_deg.size())};
  }
  return std::nullopt;
}

std::optional<PoseWander> MeasureWander(const TelemetryTrack& track, const std::vector<MeasuredLink>& links, const MotionGeometry& geometry,
                                        int frames) {
  std::vector<Eigen::Vector2d> run;
  std::optional<Homography> first_from_ground;
  Affine first_from_current;
  double sum_px2 = 0.0;
  double degrees_freedom = 0.0;
  int compared = 0;
  double px_per_rad = 0.0;
  const auto close = [&] {
    if (run.size() >= 2) {
      Eigen::Vector2d mean = Eigen::Vector2d::Zero();
      for (const Eigen::Vector2d& d : run) mean += d / static_cast<double>(run.size());
      for (const Eigen::Vector2d& d : run) sum_px2 += (d - mean).squaredNorm();
      degrees_freedom += 2.0 * static_cast<double>(run.size() - 1);
      compared += static_cast<int>(run.size());
    }
    run.clear();
  };
  for (const MeasuredLink& link : links) {
    const std::optional<Homography> ground_from_frame = GroundFromFrameAt(track, link.time_s, geometry);
    if (!run.empty() && (!link.previous_from_current.has_value() || static_cast<int>(run.size()) == frames)) close();
    if (!ground_from_frame.has_value()) {
      close();
      continue;
    }
    if (run.empty()) {
      first_from_ground = ground_from_frame->Inverse();
      first_from_current = Affine();
      px_per_rad = FocalFromHorizontalFov(geometry.width_px, *track.At(link.time_s)->camera.hfov_deg * kRad);
      run.push_back(Eigen::Vector2d::Zero());
      continue;
    }
    first_from_current = first_from_current * *link.previous_from_current;
    const Eigen::Vector2d predicted = *first_from_ground * (*ground_from_frame * geometry.middle());
    run.push_back(first_from_current * geometry.middle() - predicted);
  }
  close();
  if (compared < kFramesMin) return std::nullopt;
  PoseWander wander;
  wander.frames = compared;
  wander.rms_px = std::sqrt(sum_px2 / degrees_freedom);
  wander.rms_deg = wander.rms_px / px_per_rad / kRad;
  return wander;
}

std::vector<Eigen::Vector2d> PointingErrors(const TelemetryTrack& track, const std::vector<MeasuredLink>& links,
                                            const MotionGeometry& geometry, int half_window) {
  std::vector<Eigen::Vector2d> sums(links.size(), Eigen::Vector2d::Zero());
  std::vector<std::size_t> run_begin(links.size(), 0);
  for (std::size_t i = 0; i < links.size(); ++i) {
    run_begin[i] = i;
    if (i == 0 || !links[i].previous_from_current.has_value()) continue;
    const std::optional<Homography> now = GroundFromFrameAt(track, links[i].time_s, geometry);
    const std::optional<Homography> before = GroundFromFrameAt(track, links[i - 1].time_s, geometry);
    if (!now.has_value() || !before.has_value()) continue;
    run_begin[i] = run_begin[i - 1];
    sums[i] = sums[i - 1] + (*links[i].previous_from_current * geometry.middle() - before->Inverse() * (*now * geometry.middle()));
  }
  std::vector<Eigen::Vector2d> errors(links.size(), Eigen::Vector2d::Zero());
  const auto half = static_cast<std::size_t>(half_window);
  for (std::size_t i = 0; i < links.size(); ++i) {
    const std::size_t begin = std::max(run_begin[i], i > half ? i - half : 0);
    std::size_t end = i + 1;
    while (end < links.size() && end <= i + half && run_begin[end] == run_begin[i]) ++end;
    Eigen::Vector2d mean = Eigen::Vector2d::Zero();
    for (std::size_t k = begin; k < end; ++k) mean += sums[k] / static_cast<double>(end - begin);
    errors[i] = sums[i] - mean;
  }
  return errors;
}

CameraSample Repointed(const CameraSample& camera, const Eigen::Vector2d& shift_px, const MotionGeometry& geometry) {
  const double focal_px = FocalFromHorizontalFov(geometry.width_px, *camera.hfov_deg * kRad);
  const Eigen::Vector3d axis(shift_px.x() / focal_px, shift_px.y() / focal_px, 1.0);
  const Eigen::Matrix3d turn = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), axis).toRotationMatrix();
  const Eigen::Matrix3d world_from_camera = WorldFromCamera(camera.yaw_deg * kRad, camera.pitch_deg * kRad, camera.roll_deg * kRad);
  const Eigen::Vector3d angles = AnglesOfRotation(world_from_camera * turn);
  CameraSample repointed = camera;
  repointed.yaw_deg = angles[0] / kRad;
  repointed.pitch_deg = angles[1] / kRad;
  repointed.roll_deg = angles[2] / kRad;
  return repointed;
}

}  // namespace trem
