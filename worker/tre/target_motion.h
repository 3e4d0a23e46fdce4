#pragma once

#include <Eigen/Core>
#include <optional>

#include "mosaic/geometry/affine.h"

namespace trem {

// Where a tracked target is expected in the sensor: a Kalman filter on its position and its own velocity over the ground, both axes
// alike. The camera's motion is taken out where it was measured, so that a jerk of the camera is not one of the target.
//
//   p' = G (p + v),  v' = G.linear v,   acceleration white with standard deviation kAccelerationPx
//
// G: sensor pixels of the new frame from those of the old one, of the ground. Without measurements the uncertainty grows with the 3/2
// power of the frames. Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, 6.2.
class TargetMotion {
 public:
  // A target at `position` [sensor px] whose velocity is `velocity` [px a frame] +- `velocity_sigma_px`.
  TargetMotion(const Eigen::Vector2d& position, const Eigen::Vector2d& velocity, double velocity_sigma_px)
      : position_(position), velocity_(velocity), pv_(0.0), vv_(velocity_sigma_px * velocity_sigma_px) {}

  // One frame on. Without `new_from_old` the camera is taken to go on as before, with an uncertainty that says so.
  void Step(const std::optional<Affine>& new_from_old);
  // The target was found at `position`, give or take `sigma_px` an axis.
  void Measure(const Eigen::Vector2d& position, double sigma_px);

  const Eigen::Vector2d& position() const { return position_; }
  const Eigen::Vector2d& velocity() const { return velocity_; }
  // Standard deviation of a coordinate of the position.
  double sigma_px() const;
  // Of the last step: the ground's motion, new_from_old.
  const Affine& camera() const { return camera_; }

  static constexpr double kAccelerationPx = 0.3;   // [px a frame^2].
  static constexpr double kUnknownCameraPx = 4.0;  // Of a frame's camera motion that was not measured.

 private:
  Eigen::Vector2d position_;
  Eigen::Vector2d velocity_;
  // Covariance of (position, velocity) along either axis.
  double pp_ = 0.0;
  double pv_;
  double vv_;
  Affine camera_;
};

}  // namespace trem
