#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <vector>

#include "mosaic/geometry/camera.h"
#include "mosaic/geometry/ground_surface.h"
#include "mosaic/raster/crs.h"
#include "worker/telemetry/telemetry_audit.h"

namespace trem {

// A record in a working world: UTM coordinates less an origin, divided by the projection's scale; metres.
struct AuditRecord {
  const TelemetryRecord* record = nullptr;
  std::optional<Eigen::Vector2d> sensor;
  double convergence_rad = 0.0;  // At the sensor: grid bearing = true bearing - convergence.
  std::optional<Eigen::Vector2d> centre;
  std::optional<std::array<Eigen::Vector2d, 4>> corners;
  double tan_half_hfov = 0.0;  // 0: unknown.
  double tan_half_vfov = 0.0;
};

struct Prediction {
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  std::array<Eigen::Vector2d, 4> corners;
  double slant_m = 0.0;
};

// The camera's rotation world_from_camera with x east, y north OF THE CONVENTION'S north, z up. Preconditions: azimuth and elevation are
// there, and for the relative readings the heading.
std::optional<Eigen::Matrix3d> CameraRotation(const TelemetryRecord& record, const TelemetryConvention& convention);

// Yaw, pitch and roll [rad] of a rotation as WorldFromCamera makes it; roll is 0 where the axis is vertical.
Eigen::Vector3d AnglesOfRotation(const Eigen::Matrix3d& world_from_camera);

std::optional<double> AltitudeOf(const TelemetryRecord& record, const TelemetryConvention& convention);
// Elevation of the ground that the convention takes for the record; nothing when the record does not state it (or it is a surface).
std::optional<double> GroundOf(const TelemetryRecord& record, const TelemetryConvention& convention, const AuditOptions& options);

// What the record should state under the convention; nothing when it lacks what that takes or a ray does not meet the ground. `surface` in
// the working world, or null.
std::optional<Prediction> Predict(const AuditRecord& record, const TelemetryConvention& convention, const AuditOptions& options,
                                  const GroundSurface* surface);

}  // namespace trem
