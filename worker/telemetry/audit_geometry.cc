#include "worker/telemetry/audit_geometry.h"

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

namespace trem {
namespace {

constexpr double kRad = std::numbers::pi / 180.0;

// Body axes (x forward, y right, z down) turned by heading, pitch and roll, the aerospace sequence z, y', x'': north-east-down from body.
Eigen::Matrix3d NedFromBody(double heading_rad, double pitch_rad, double roll_rad) {
  return (Eigen::AngleAxisd(heading_rad, Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(pitch_rad, Eigen::Vector3d::UnitY()) *
          Eigen::AngleAxisd(roll_rad, Eigen::Vector3d::UnitX()))
      .toRotationMatrix();
}

}  // namespace

std::optional<Eigen::Matrix3d> CameraRotation(const TelemetryRecord& record, const TelemetryConvention& convention) {
  if (!record.HasPointing()) return std::nullopt;
  const double azimuth = *record.sensor_azimuth_deg * kRad;
  const double sign = convention.elevation == ElevationReading::kUp ? 1.0 : -1.0;
  const double elevation = sign * *record.sensor_elevation_deg * kRad;
  const double roll = record.sensor_roll_deg.value_or(0.0) * kRad;
  Eigen::Matrix3d ned_from_body = Eigen::Matrix3d::Identity();
  if (convention.azimuth != AzimuthReading::kAbsolute) {
    if (!record.platform_heading_deg.has_value()) return std::nullopt;
    const bool full = convention.azimuth == AzimuthReading::kRelative;
    ned_from_body = NedFromBody(*record.platform_heading_deg * kRad, full ? record.platform_pitch_deg.value_or(0.0) * kRad : 0.0,
                                full ? record.platform_roll_deg.value_or(0.0) * kRad : 0.0);
  }
  // Sensor axes (x along the optical axis, y to the image's right, z to its bottom) are turned in the same sequence.
  const Eigen::Matrix3d ned_from_sensor = ned_from_body * NedFromBody(azimuth, elevation, roll);
  Eigen::Matrix3d enu_from_ned;
  enu_from_ned << 0, 1, 0, 1, 0, 0, 0, 0, -1;
  Eigen::Matrix3d sensor_from_camera;
  sensor_from_camera << 0, 0, 1, 1, 0, 0, 0, 1, 0;
  return Eigen::Matrix3d(enu_from_ned * ned_from_sensor * sensor_from_camera);
}

Eigen::Vector3d AnglesOfRotation(const Eigen::Matrix3d& world_from_camera) {
  const Eigen::Vector3d right = world_from_camera.col(0);
  const Eigen::Vector3d down = world_from_camera.col(1);
  const Eigen::Vector3d forward = world_from_camera.col(2);
  const double level = forward.head<2>().norm();
  const double pitch = std::atan2(forward.z(), level);
  // Straight down (or up) the image's up (or down) is where the axis would turn to.
  if (level < 1e-9) return {std::atan2(-down.x() * (forward.z() < 0 ? 1 : -1), -down.y() * (forward.z() < 0 ? 1 : -1)), pitch, 0.0};
  const double yaw = std::atan2(forward.x(), forward.y());
  // With roll 0 the right axis is level: (cos yaw, -sin yaw, 0). A clockwise roll turns it towards down.
  const Eigen::Matrix3d level_axes = WorldFromCamera(yaw, pitch, 0.0);
  const double roll = std::atan2(right.dot(level_axes.col(1)), right.dot(level_axes.col(0)));
  return {yaw, pitch, roll};
}

std::optional<double> AltitudeOf(const TelemetryRecord& record, const TelemetryConvention& convention) {
  return convention.altitude == HeightReading::kMsl ? record.altitude_msl_m : record.altitude_hae_m;
}

std::optional<double> GroundOf(const TelemetryRecord& record, const TelemetryConvention& convention, const AuditOptions& options) {
  switch (convention.ground) {
    case TelemetryConvention::Ground::kGiven:
      return options.ground_elevation_m;
    case TelemetryConvention::Ground::kCentreMsl:
      return record.centre_elevation_msl_m;
    case TelemetryConvention::Ground::kCentreEllipsoid:
      return record.centre_elevation_hae_m;
    case TelemetryConvention::Ground::kZero:
      return 0.0;
    case TelemetryConvention::Ground::kSurface:
      break;
  }
  return std::nullopt;
}

std::optional<Prediction> Predict(const AuditRecord& record, const TelemetryConvention& convention, const AuditOptions& options,
                                  const GroundSurface* surface) {
  const std::optional<double> altitude_m = AltitudeOf(*record.record, convention);
  const std::optional<Eigen::Matrix3d> rotation = CameraRotation(*record.record, convention);
  if (!record.sensor.has_value() || !altitude_m.has_value() || !rotation.has_value()) return std::nullopt;
  const bool relief = convention.ground == TelemetryConvention::Ground::kSurface;
  const std::optional<double> ground_m = GroundOf(*record.record, convention, options);
  if (relief ? surface == nullptr : !ground_m.has_value()) return std::nullopt;
  const LevelGround level(ground_m.value_or(0.0));
  const GroundSurface& ground = relief ? *surface : static_cast<const GroundSurface&>(level);
  // From true north to the working world's grid.
  const double turn = convention.north == NorthReading::kTrue ? record.convergence_rad : 0.0;
  const Eigen::Matrix3d world_from_camera = Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitZ()).toRotationMatrix() * *rotation;
  const Eigen::Vector3d position(record.sensor->x(), record.sensor->y(), *altitude_m);
  const std::optional<Eigen::Vector3d> centre = IntersectSurface(position, world_from_camera.col(2), ground);
  if (!centre.has_value()) return std::nullopt;
  Prediction prediction;
  prediction.centre = centre->head<2>();
  prediction.slant_m = (*centre - position).norm();
  if (!record.corners.has_value() || record.tan_half_hfov <= 0.0) return prediction;
  constexpr std::array<std::array<double, 2>, 4> kSigns = {{{-1, -1}, {1, -1}, {1, 1}, {-1, 1}}};
  for (std::size_t k = 0; k < 4; ++k) {
    const Eigen::Vector3d ray(kSigns[k][0] * record.tan_half_hfov, kSigns[k][1] * record.tan_half_vfov, 1.0);
    const std::optional<Eigen::Vector3d> corner = IntersectSurface(position, world_from_camera * ray, ground);
    if (!corner.has_value()) return std::nullopt;
    prediction.corners[k] = corner->head<2>();
  }
  return prediction;
}

}  // namespace trem
