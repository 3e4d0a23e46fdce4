#include "mosaic/geometry/camera.h"

#include <cmath>

namespace trem {

double FocalFromHorizontalFov(int width_px, double hfov_rad) { return 0.5 * width_px / std::tan(0.5 * hfov_rad); }

Homography GroundFromSensor(const CameraPose& pose, const CameraIntrinsics& intrinsics, double ground_z_m) {
  const Eigen::Matrix3d world_from_camera = WorldFromCamera(pose.yaw_rad, pose.pitch_rad, pose.roll_rad);
  const double cx = 0.5 * (intrinsics.width_px - 1);
  const double cy = 0.5 * (intrinsics.height_px - 1);
  Eigen::Matrix3d camera_from_sensor;
  camera_from_sensor << 1.0 / intrinsics.focal_px, 0.0, -cx / intrinsics.focal_px, 0.0, 1.0 / intrinsics.focal_px,
      -cy / intrinsics.focal_px, 0.0, 0.0, 1.0;
  // The ray position + s * direction meets the plane at s = -height / direction.z; with w = -direction.z the ground point is
  // position.xy + height * direction.xy / w.
  const Eigen::Matrix3d direction = world_from_camera * camera_from_sensor;
  const double height = pose.position_m.z() - ground_z_m;
  Homography ground_from_sensor;
  ground_from_sensor.matrix.row(2) = -direction.row(2);
  ground_from_sensor.matrix.row(0) = height * direction.row(0) + pose.position_m.x() * ground_from_sensor.matrix.row(2);
  ground_from_sensor.matrix.row(1) = height * direction.row(1) + pose.position_m.y() * ground_from_sensor.matrix.row(2);
  return ground_from_sensor;
}

std::optional<Eigen::Vector2d> IntersectGround(const CameraPose& pose, const CameraIntrinsics& intrinsics, double ground_z_m,
                                               const Eigen::Vector2d& u) {
  if (pose.position_m.z() <= ground_z_m) return std::nullopt;
  const Homography ground_from_sensor = GroundFromSensor(pose, intrinsics, ground_z_m);
  if (ground_from_sensor.Depth(u) <= 1e-9) return std::nullopt;
  return ground_from_sensor * u;
}

}  // namespace trem
