#include "worker/simulate/flight.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "mosaic/base/rng.h"
#include "mosaic/raster/crs.h"
#include "worker/simulate/aim_path.h"

namespace trem {
namespace {

constexpr double kRadPerDeg = std::numbers::pi / 180.0;
// Beyond the image's edge the truth must still reach for the point spread function and the spline: pixels.
constexpr double kMarginPx = 5.0;
// Runs of frames of one exposure, where it steps.
constexpr int kExposureRuns = 6;

enum Purpose : std::uint64_t {
  kAttitudeWander = 1,
  kAttitudeJitter,
  kPositionWander,
  kGainDrift,
  kOffsetDrift,
  kBias,
  kGpsNoise,
  kAttitudeNoise,
  kDrop,
  kAttitudeBias
};

// A slow bounded wander: the mean of three sine waves of random phase with periods of 40 to 200 frames. |value| <= 1, rms 0.41.
class Wander {
 public:
  Wander(std::uint64_t seed, std::uint64_t purpose, std::uint64_t axis) {
    Rng rng({seed, purpose, axis});
    for (int i = 0; i < 3; ++i) {
      phase_[i] = 2.0 * std::numbers::pi * rng.Uniform();
      rate_[i] = 2.0 * std::numbers::pi / (40.0 + 160.0 * rng.Uniform());
    }
  }
  double At(int frame) const {
    double sum = 0.0;
    for (int i = 0; i < 3; ++i) sum += std::sin(phase_[i] + rate_[i] * frame);
    return sum / 3.0;
  }
  static constexpr double kRms = 0.4082482904638631;  // 1 / sqrt(6).

 private:
  double phase_[3] = {};
  double rate_[3] = {};
};

Eigen::Matrix3d SmallRotation(const Eigen::Vector3d& angles_rad) {
  const double angle = angles_rad.norm();
  if (angle == 0.0) return Eigen::Matrix3d::Identity();
  return Eigen::AngleAxisd(angle, angles_rad / angle).toRotationMatrix();
}

Eigen::Vector3d NormalVector(std::uint64_t seed, std::uint64_t purpose, int frame, double sigma) {
  Rng rng({seed, purpose, static_cast<std::uint64_t>(frame)});
  Eigen::Vector3d v;
  for (int i = 0; i < 3; ++i) v[i] = sigma * rng.Normal();
  return v;
}

// Everything about the flight that does not depend on where the aim point is.
struct Wobble {
  std::vector<Eigen::Matrix3d> rotation;    // map_from_camera.
  std::vector<Eigen::Vector3d> position_m;  // Camera, relative to its nominal place.
};

Wobble MakeWobble(const SimulationOptions& options, double yaw_grid_rad) {
  const Eigen::Matrix3d nominal = RotationFromAttitude({yaw_grid_rad, options.pitch_deg * kRadPerDeg, 0.0});
  Wobble wobble;
  std::vector<Wander> attitude;
  std::vector<Wander> position;
  for (std::uint64_t axis = 0; axis < 3; ++axis) {
    attitude.emplace_back(options.seed, kAttitudeWander, axis);
    position.emplace_back(options.seed, kPositionWander, axis);
  }
  for (int frame = 0; frame < options.frame_count; ++frame) {
    Eigen::Vector3d angles = NormalVector(options.seed, kAttitudeJitter, frame, options.jitter_deg * kRadPerDeg);
    Eigen::Vector3d place;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      angles[static_cast<int>(axis)] += options.wander_deg * kRadPerDeg * attitude[axis].At(frame);
      place[static_cast<int>(axis)] = options.position_wander_m * position[axis].At(frame);
    }
    wobble.rotation.push_back(nominal * SmallRotation(angles));
    wobble.position_m.push_back(place);
  }
  return wobble;
}

// Box, relative to the aim point, around the footprints of all frames with their margin; false when some ray does not descend.
bool FootprintBox(const SimulationOptions& options, const Wobble& wobble, const CameraState& nominal, double focal_px, Eigen::Vector2d* low,
                  Eigen::Vector2d* high) {
  *low = Eigen::Vector2d::Constant(1e300);
  *high = -*low;
  for (std::size_t i = 0; i < wobble.rotation.size(); ++i) {
    CameraState camera = nominal;
    camera.map_from_camera = wobble.rotation[i];
    camera.position_m += nominal.map_scale * wobble.position_m[i].head<2>();
    camera.height_m += wobble.position_m[i].z();
    for (const double x : {-0.5 - kMarginPx, options.width_px - 0.5 + kMarginPx}) {
      for (const double y : {-0.5 - kMarginPx, options.height_px - 0.5 + kMarginPx}) {
        const Eigen::Vector3d ray((x - 0.5 * (options.width_px - 1)) / focal_px, (y - 0.5 * (options.height_px - 1)) / focal_px, 1.0);
        const Eigen::Vector3d direction = camera.map_from_camera * ray;
        // Nearer to the horizon than 3 degrees nothing useful is seen.
        if (direction.z() / direction.norm() > -0.05 || camera.height_m <= 0.0) return false;
        for (const double z : {-0.5 * options.relief_m, 0.5 * options.relief_m}) {
          CameraState above = camera;
          above.height_m -= z;
          above.relief = nullptr;
          const Eigen::Vector2d ground = GroundFromPixel(above, focal_px, options.width_px, options.height_px, {x, y});
          *low = low->cwiseMin(ground);
          *high = high->cwiseMax(ground);
        }
      }
    }
  }
  return true;
}

Result<TelemetryRow> RowFromCamera(const CameraState& camera, double ground_elevation_m, const UtmFrame& frame) {
  TREM_ASSIGN_OR_RETURN(const Eigen::Vector2d place, frame.Inverse(camera.position_m));
  TREM_ASSIGN_OR_RETURN(const double convergence_rad, frame.ConvergenceRad(place.x(), place.y()));
  TelemetryRow row;
  row.latitude_deg = place.x();
  row.longitude_deg = place.y();
  row.altitude_m = ground_elevation_m + camera.height_m;
  row.attitude = AttitudeFromRotation(camera.map_from_camera);
  row.attitude.yaw_rad += convergence_rad;  // grid bearing = true bearing - convergence.
  return row;
}

// What the instruments say of the camera.
Result<TelemetryRow> ReportedRow(const SimulationOptions& options, const Flight& flight, const Exposure& exposure, const UtmFrame& frame) {
  CameraState reported = exposure.camera;
  const Eigen::Vector3d noise = NormalVector(options.seed, kGpsNoise, exposure.index, options.gps_noise_m);
  reported.position_m += flight.gps_bias_m + noise.head<2>();
  reported.height_m += noise.z();
  reported.map_from_camera = exposure.camera.map_from_camera *
                             SmallRotation(NormalVector(options.seed, kAttitudeBias, 0, options.attitude_bias_deg * kRadPerDeg)) *
                             SmallRotation(NormalVector(options.seed, kAttitudeNoise, exposure.index,
                                                        options.attitude_noise_deg * kRadPerDeg));
  return RowFromCamera(reported, options.ground_elevation_m, frame);
}

}  // namespace

Eigen::Matrix3d RotationFromAttitude(const Attitude& attitude) {
  const double cy = std::cos(attitude.yaw_rad), sy = std::sin(attitude.yaw_rad);
  const double cp = std::cos(attitude.pitch_rad), sp = std::sin(attitude.pitch_rad);
  const double cr = std::cos(attitude.roll_rad), sr = std::sin(attitude.roll_rad);
  const Eigen::Vector3d axis(sy * cp, cy * cp, sp);
  const Eigen::Vector3d level_right(cy, -sy, 0.0);
  const Eigen::Vector3d level_bottom = axis.cross(level_right);
  Eigen::Matrix3d rotation;
  rotation << cr * level_right + sr * level_bottom, cr * level_bottom - sr * level_right, axis;
  return rotation;
}

Attitude AttitudeFromRotation(const Eigen::Matrix3d& rotation) {
  const Eigen::Vector3d axis = rotation.col(2);
  const double horizontal = std::hypot(axis.x(), axis.y());
  Attitude attitude;
  attitude.pitch_rad = std::atan2(axis.z(), horizontal);
  attitude.yaw_rad = horizontal < 1e-12 ? 0.0 : std::atan2(axis.x(), axis.y());
  const Eigen::Vector3d level_right(std::cos(attitude.yaw_rad), -std::sin(attitude.yaw_rad), 0.0);
  const Eigen::Vector3d level_bottom = axis.cross(level_right);
  attitude.roll_rad = std::atan2(rotation.col(0).dot(level_bottom), rotation.col(0).dot(level_right));
  return attitude;
}

Eigen::Vector2d MeetGround(const CameraState& camera, const Eigen::Vector3d& direction) {
  TREM_CHECK(direction.z() < 0.0);
  const Eigen::Vector2d per_metre = camera.map_scale / -direction.z() * direction.head<2>();
  Eigen::Vector2d ground = camera.position_m + camera.height_m * per_metre;
  if (camera.relief == nullptr) return ground;
  // Hills are so gentle that a ray meets them once: the iteration shrinks by slope times tangent of the view's angle.
  constexpr int kIterationsMax = 60;
  constexpr double kTolerance_m = 1e-6;
  double z = 0.0;
  for (int i = 0; i < kIterationsMax; ++i) {
    const double next = camera.relief->ElevationAt(ground).value_or(z);
    ground = camera.position_m + (camera.height_m - next) * per_metre;
    if (std::abs(next - z) < kTolerance_m) break;
    z = next;
  }
  return ground;
}

Eigen::Vector2d GroundFromPixel(const CameraState& camera, double focal_px, int width_px, int height_px, const Eigen::Vector2d& u) {
  const Eigen::Vector3d ray((u.x() - 0.5 * (width_px - 1)) / focal_px, (u.y() - 0.5 * (height_px - 1)) / focal_px, 1.0);
  return MeetGround(camera, camera.map_from_camera * ray);
}

Eigen::Vector2d PixelFromGround(const CameraState& camera, double focal_px, int width_px, int height_px, const Eigen::Vector2d& ground) {
  const Eigen::Vector2d offset_m = (ground - camera.position_m) / camera.map_scale;
  const double z = camera.relief == nullptr ? 0.0 : camera.relief->ElevationAt(ground).value_or(0.0);
  const Eigen::Vector3d in_camera = camera.map_from_camera.transpose() * Eigen::Vector3d(offset_m.x(), offset_m.y(), z - camera.height_m);
  TREM_CHECK(in_camera.z() > 0.0);
  return {0.5 * (width_px - 1) + focal_px * in_camera.x() / in_camera.z(),
          0.5 * (height_px - 1) + focal_px * in_camera.y() / in_camera.z()};
}

Result<Flight> PlanFlight(const SimulationOptions& options, const Truth& truth) {
  TREM_ASSIGN_OR_RETURN(const UtmFrame frame, UtmFrame::ForPoint(options.origin_lat_deg, options.origin_lon_deg));
  TREM_ASSIGN_OR_RETURN(const double convergence_rad, frame.ConvergenceRad(options.origin_lat_deg, options.origin_lon_deg));
  TREM_ASSIGN_OR_RETURN(const double map_scale, frame.ScaleFactor(options.origin_lat_deg, options.origin_lon_deg));
  Flight flight;
  flight.focal_px = 0.5 * options.width_px / std::tan(0.5 * options.hfov_deg * kRadPerDeg);

  // The slant range that gives the wanted ground sample distance, in metres (gsd_m is in map metres).
  const double range_m = options.gsd_m / map_scale * flight.focal_px;
  const double yaw_grid_rad = options.yaw_deg * kRadPerDeg - convergence_rad;
  CameraState nominal;
  nominal.map_from_camera = RotationFromAttitude({yaw_grid_rad, options.pitch_deg * kRadPerDeg, 0.0});
  nominal.map_scale = map_scale;
  nominal.relief = truth.relief.get();
  nominal.height_m = -range_m * nominal.map_from_camera(2, 2);
  nominal.position_m = -map_scale * range_m * nominal.map_from_camera.col(2).head<2>();  // Aiming at (0, 0).

  const Wobble wobble = MakeWobble(options, yaw_grid_rad);
  AimLimits limits;
  if (!FootprintBox(options, wobble, nominal, flight.focal_px, &limits.footprint_low_m, &limits.footprint_high_m)) {
    return InvalidInput(
        fmt::format("some rays of the camera (pitch {} deg, vertical field {:.1f} deg) do not come down to the ground; "
                    "use a steeper --pitch-deg or a smaller --hfov-deg",
                    options.pitch_deg, 2.0 * std::atan(0.5 * options.height_px / flight.focal_px) / kRadPerDeg));
  }
  const Eigen::Vector2d upper_left_m = truth.grid.WorldFromPixel({0.0, 0.0});
  const Eigen::Vector2d lower_right_m = truth.grid.WorldFromPixel({truth.grey.width() - 1.0, truth.grey.height() - 1.0});
  limits.truth_low_m = {upper_left_m.x(), lower_right_m.y()};
  limits.truth_high_m = {lower_right_m.x(), upper_left_m.y()};
  TREM_ASSIGN_OR_RETURN(const AimPath path, PlanAimPath(options, limits));
  flight.speed_px = path.speed_px;

  Rng bias({options.seed, kBias});
  const double bias_bearing_rad = 2.0 * std::numbers::pi * bias.Uniform();
  flight.gps_bias_m = options.gps_bias_m * Eigen::Vector2d(std::sin(bias_bearing_rad), std::cos(bias_bearing_rad));
  const Wander gain_wander(options.seed, kGainDrift, 0);
  const Wander offset_wander(options.seed, kOffsetDrift, 0);
  flight.seen_min_m = Eigen::Vector2d::Constant(1e300);
  flight.seen_max_m = -flight.seen_min_m;
  for (int i = 0; i < options.frame_count; ++i) {
    const auto index = static_cast<std::size_t>(i);
    Exposure exposure;
    exposure.index = i;
    exposure.time_s = i / options.frame_rate_hz;
    exposure.dropped = Rng({options.seed, kDrop, static_cast<std::uint64_t>(i)}).Uniform() < options.drop_fraction;
    exposure.camera = nominal;
    exposure.camera.map_from_camera = wobble.rotation[index];
    exposure.camera.position_m += path.aim_m[index] + map_scale * wobble.position_m[index].head<2>();
    exposure.camera.height_m += wobble.position_m[index].z();
    const bool stepped = (kExposureRuns * i / options.frame_count) % 2 == 1;
    exposure.gain =
        options.gain * (1.0 + options.gain_drift / Wander::kRms * gain_wander.At(i)) * (stepped ? 1.0 - options.exposure_step : 1.0);
    exposure.offset = options.offset + options.offset_drift / Wander::kRms * offset_wander.At(i);
    TREM_ASSIGN_OR_RETURN(exposure.true_row, RowFromCamera(exposure.camera, options.ground_elevation_m, frame));
    TREM_ASSIGN_OR_RETURN(exposure.reported_row, ReportedRow(options, flight, exposure, frame));
    flight.seen_min_m = flight.seen_min_m.cwiseMin(path.aim_m[index] + limits.footprint_low_m);
    flight.seen_max_m = flight.seen_max_m.cwiseMax(path.aim_m[index] + limits.footprint_high_m);
    flight.exposures.push_back(exposure);
  }
  return flight;
}

}  // namespace trem
