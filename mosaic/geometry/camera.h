#pragma once

#include <Eigen/Core>
#include <optional>

#include "mosaic/geometry/homography.h"

namespace trem {

// A pinhole camera above a horizontal ground plane, in a local metric frame: x east, y north, z up, right-handed.
//
// Angles in radians, as in docs/USER_GUIDE (telemetry.csv): yaw clockwise from north of the optical axis' ground direction; pitch the
// elevation of the optical axis (-pi/2: straight down); roll about the optical axis, clockwise positive seen from behind the camera.
// At yaw 0, pitch -pi/2, roll 0 the image's up is north and its right is east. Square pixels; the optical axis goes through the image
// centre ((width - 1) / 2, (height - 1) / 2).
struct CameraPose {
  Eigen::Vector3d position_m = Eigen::Vector3d::Zero();
  double yaw_rad = 0.0;
  double pitch_rad = 0.0;
  double roll_rad = 0.0;
};

struct CameraIntrinsics {
  int width_px = 0;
  int height_px = 0;
  double focal_px = 0.0;  // (width / 2) / tan(hfov / 2).
};

double FocalFromHorizontalFov(int width_px, double hfov_rad);

// Rotation world_from_camera; camera axes: x to the image's right, y to the image's bottom, z along the optical axis.
// Templated on the scalar for Ceres' automatic differentiation.
template <typename T>
Eigen::Matrix<T, 3, 3> WorldFromCamera(const T& yaw, const T& pitch, const T& roll) {
  using std::cos;
  using std::sin;
  const T cy = cos(yaw), sy = sin(yaw), cp = cos(pitch), sp = sin(pitch), cr = cos(roll), sr = sin(roll);
  Eigen::Matrix<T, 3, 1> forward(sy * cp, cy * cp, sp);
  Eigen::Matrix<T, 3, 1> right(cy, -sy, T(0));
  // down = forward x right: with `right` horizontal it points to the bottom of an unrolled image.
  Eigen::Matrix<T, 3, 1> down(forward(1) * right(2) - forward(2) * right(1), forward(2) * right(0) - forward(0) * right(2),
                              forward(0) * right(1) - forward(1) * right(0));
  // A camera rolled clockwise seen from behind turns its right axis towards down.
  Eigen::Matrix<T, 3, 3> world_from_camera;
  world_from_camera.col(0) = cr * right + sr * down;
  world_from_camera.col(1) = -sr * right + cr * down;
  world_from_camera.col(2) = forward;
  return world_from_camera;
}

// ground_from_sensor: maps sensor pixels to (east, north) [m] on the plane z = ground_z_m. Pixels above the horizon have Depth() <= 0;
// all visible ones have Depth() > 0.
Homography GroundFromSensor(const CameraPose& pose, const CameraIntrinsics& intrinsics, double ground_z_m);

// Where the ray of sensor pixel `u` meets the plane z = ground_z_m; nothing when it does not descend to it.
std::optional<Eigen::Vector2d> IntersectGround(const CameraPose& pose, const CameraIntrinsics& intrinsics, double ground_z_m,
                                               const Eigen::Vector2d& u);

}  // namespace trem
