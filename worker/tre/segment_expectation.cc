// Where a segment expects its next frame: see worker/tre/segment.h.
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "worker/tre/segment.h"

namespace trem {
namespace {

// Standard deviation of whole-image motion at a ROI's corner [px]: reduced images, and ground that is not quite a plane.
constexpr double kMotionSigmaPx = 0.7;
constexpr double kVelocitySigmaPx = 3.0;
// Points along each side of the ROI that its overlap is counted by.
constexpr int kOverlapPoints = 16;

}  // namespace

// Constant velocity: p(A_t | A_t-1) of tre.dynamics_sigma_px.
ViewPrior Segment::PredictByDynamics() const {
  ViewPrior prior;
  prior.mean = view_;
  const double frames = 1.0 + skipped_;
  double jerks = 0.0;  // A change of velocity j frames before the end has moved the corner j times.
  for (int j = 1; j <= 1 + skipped_; ++j) {
    prior.mean.scene_from_sensor = prior.mean.scene_from_sensor * previous_from_current_;
    jerks += static_cast<double>(j) * j;
  }
  // Before two frames are known nothing is known of the velocity.
  const double sigma = options_.dynamics_sigma_px;
  const double start = frame_count_ < 2 ? std::pow(std::max(kVelocitySigmaPx, sigma), 2) : 0.0;
  const Eigen::Index n = covariance_.rows();
  const CornerMatrix covariance = covariance_ + frames * frames * velocity_covariance_ +
                                  (jerks * sigma * sigma + frames * frames * start) * CornerMatrix::Identity(n, n);
  prior.information = covariance.inverse();
  return prior;
}

ViewPrior Segment::Predict(const FrameInput& frame) const {
  ViewPrior prior;
  prior.mean = view_;
  const bool measured = frame.previous_from_current.has_value();
  const PlanarMap motion = measured ? PlanarMap(*frame.previous_from_current) : previous_from_current_;
  prior.mean.scene_from_sensor = view_.scene_from_sensor * lost_from_current_ * motion;
  const double sigma = (measured ? kMotionSigmaPx : kVelocitySigmaPx) * std::sqrt(1.0 + skipped_);
  // The last view's own uncertainty is part of the prediction's: a ROI without texture must not gain confidence by being predicted.
  const CornerMatrix covariance = covariance_ + CornerMatrix::Identity(covariance_.rows(), covariance_.rows()) * sigma * sigma;
  prior.information = covariance.inverse();
  return prior;
}

double Segment::MotionTolerancePx(const FrameInput& frame, const PlanarMap& expected) const {
  if (!frame.previous_from_current.has_value()) return 0.35 * std::min(roi_.width(), roi_.height());
  // Whole-image motion is an affine map from reduced images: the longer the hop, the more a ROI may differ from it.
  return 6.0 + 2.0 * skipped_ + 0.1 * LargestCornerMotion(view_.scene_from_sensor, expected, roi_);
}

bool Segment::HasMovedOff(const FrameInput& frame, Expected expected_as) const {
  if (!frame.previous_from_current.has_value() || !lost_motion_known_) return false;
  const PlanarMap expected = Predict(frame).mean.scene_from_sensor;
  const double margin = expected_as == Expected::kAtWorst ? options_.ratio * MotionTolerancePx(frame, expected) : 0.0;
  const Roi& seen = buffer_.extent;
  const Roi roi = RoiOf(frame);
  int over = 0;
  for (int v = 0; v < kOverlapPoints; ++v) {
    for (int u = 0; u < kOverlapPoints; ++u) {
      const Eigen::Vector2d sensor(roi.x0 + (u + 0.5) * roi.width() / kOverlapPoints - 0.5,
                                   roi.y0 + (v + 0.5) * roi.height() / kOverlapPoints - 0.5);
      const Eigen::Vector2d cell = expected * sensor;
      if (cell.x() > seen.x0 - margin && cell.x() < seen.x1 + margin && cell.y() > seen.y0 - margin && cell.y() < seen.y1 + margin) ++over;
    }
  }
  return over < kRegistrationOverlapMin * kOverlapPoints * kOverlapPoints;
}

void Segment::SkipFrame(const FrameInput& frame) {
  lost_from_current_ =
      lost_from_current_ * (frame.previous_from_current ? PlanarMap(*frame.previous_from_current) : previous_from_current_);
  lost_motion_known_ = lost_motion_known_ && frame.previous_from_current.has_value();
  ++skipped_;
}

}  // namespace trem
