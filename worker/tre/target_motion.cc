#include "worker/tre/target_motion.h"

#include <cmath>

namespace trem {

void TargetMotion::Step(const std::optional<Affine>& new_from_old) {
  if (new_from_old) camera_ = *new_from_old;
  position_ = camera_ * (position_ + velocity_);
  velocity_ = camera_.linear * velocity_;
  const double q = kAccelerationPx * kAccelerationPx;
  pp_ += 2.0 * pv_ + vv_ + 0.25 * q + (new_from_old ? 0.0 : kUnknownCameraPx * kUnknownCameraPx);
  pv_ += vv_ + 0.5 * q;
  vv_ += q;
}

void TargetMotion::Measure(const Eigen::Vector2d& position, double sigma_px) {
  const double innovation_variance = pp_ + sigma_px * sigma_px;
  const double position_gain = pp_ / innovation_variance;
  const double velocity_gain = pv_ / innovation_variance;
  const Eigen::Vector2d innovation = position - position_;
  position_ += position_gain * innovation;
  velocity_ += velocity_gain * innovation;
  vv_ -= velocity_gain * pv_;
  pv_ *= 1.0 - position_gain;
  pp_ *= 1.0 - position_gain;
}

double TargetMotion::sigma_px() const { return std::sqrt(pp_); }

}  // namespace trem
