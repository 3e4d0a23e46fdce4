// What a segment knows of its own place on its plane, and how it mends it: see worker/tre/segment.h.
#include <Eigen/LU>
#include <algorithm>

#include "worker/tre/segment.h"

namespace trem {
namespace {

// Frames after which the first ones are registered again; how much each must overlap what is settled, and may move.
constexpr int kRevisitedFrames = 8;
constexpr double kRevisitOverlapMin = 0.25;
constexpr double kRevisitMotionMaxPx = 0.5;
constexpr std::uint64_t kRevisitStream = std::uint64_t{1} << 32;  // Its random streams are not those of the first time.
constexpr double kMotionSigmaPx = 0.7;
constexpr int kRevisitIterations = 20;

Observation ObservationOfWhole(const FrameInput& frame, const Roi& roi, double noise_sigma) {
  return {&frame.pixels, roi, noise_sigma, frame.weights.empty() ? nullptr : &frame.weights};
}

}  // namespace

void Segment::KeepForRevisit(const FrameInput& frame, const Image<float>* weights, const Registration& registration, double noise_sigma) {
  // Ground that has been made anew is not to be made from what it was.
  if (!movers_.outvoted().empty()) early_.clear();
  if (early_.empty()) return;
  early_.emplace_back(frame, registration);
  if (weights != nullptr) early_.back().first.weights = *weights;
  if (static_cast<int>(early_.size()) == kRevisitedFrames) Revisit(noise_sigma);
}

void Segment::CarrySceneCovariance(const PlanarMap& motion, const SceneSupport& support, const CornerMatrix& own) {
  const Eigen::Index n = own.rows();
  CornerMatrix carried(n, n);
  for (Eigen::Index k = 0; k < n / 2; ++k) {
    const Eigen::Vector2d corner(k % 2 == 0 ? roi_.x0 : roi_.x1 - 1, k / 2 == 0 ? roi_.y0 : roi_.y1 - 1);
    carried.middleRows<2>(2 * k) = motion.LinearisedAt(corner).linear.inverse() * CornerJacobian(roi_, motion * corner, ModelOf(n));
  }
  const CornerMatrix before = scene_covariance_;
  scene_covariance_ = carried * before * carried.transpose();
  const double variance = own.trace() / static_cast<double>(n);
  for (Eigen::Index k = 0; k < n / 2; ++k) {
    for (Eigen::Index l = 0; l < n / 2; ++l) {
      scene_covariance_.block<2, 2>(2 * k, 2 * l) += 2.0 * variance * support.unevenness(k, l) * Eigen::Matrix2d::Identity();
    }
  }
}

void Segment::Revisit(double noise_sigma) {
  std::vector<std::pair<FrameInput, Registration>> early = std::exchange(early_, {});
  std::vector<Registration> found;
  for (const auto& [frame, registration] : early) {
    RegistrationRequest request;
    request.prior.mean = registration.view;
    const Eigen::Index n = covariance_.rows();
    request.prior.information = CornerMatrix::Identity(n, n) / (kMotionSigmaPx * kMotionSigmaPx);
    request.method = options_.registration;
    request.gain_offset = options_.gain_offset;
    request.motion_px_max = kRevisitMotionMaxPx;
    request.stream[0] = options_.seed;
    request.stream[1] = segment_id_;
    request.stream[2] = kRevisitStream + static_cast<std::uint64_t>(frame.frame_index);
    const JudgedRegistration judged = Register(ObservationOfWhole(frame, roi_, noise_sigma), ReferenceNow(SeenMin()), request);
    if (!judged.doubt.empty() || judged.registration.overlap < kRevisitOverlapMin) return;
    found.push_back(judged.registration);
  }
  const View nominal = early.front().second.view;
  const View first = found.front().view;
  const PlanarMap plane_from_scene = nominal.scene_from_sensor * first.scene_from_sensor.Inverse();
  scene_covariance_ = found.front().corner_covariance;
  std::fill(buffer_.weight.pixels().begin(), buffer_.weight.pixels().end(), 0.0F);
  std::fill(buffer_.weighted.pixels().begin(), buffer_.weighted.pixels().end(), 0.0F);
  for (std::size_t k = 0; k < found.size(); ++k) {
    View& view = found[k].view;
    view.scene_from_sensor = plane_from_scene * view.scene_from_sensor;
    view.gain /= first.gain;
    view.offset -= view.gain * first.offset;
    if (k == 0) {
      found[k] = early[k].second;
    } else {
      covariance_ = found[k].corner_covariance;
      CarrySceneCovariance(found[k - 1].view.scene_from_sensor.Inverse() * view.scene_from_sensor, {}, covariance_);
      found[k].corner_covariance += scene_covariance_;
    }
    if (kept_) kept_->Revise(early[k].first.frame_index, found[k].view);
    update_.AddFrame(ObservationOfWhole(early[k].first, roi_, noise_sigma), found[k].view, Footprint(found[k].view.scene_from_sensor), &buffer_);
    // The view is what was found again. The residuals stay those of a frame that the scene did not hold yet: they judge predictions.
    Registration revised = early[k].second;
    revised.view = found[k].view;
    revised.corner_covariance = found[k].corner_covariance;
    revised.gain_offset_covariance = found[k].gain_offset_covariance;
    revised_.push_back({early[k].first.frame_index, revised});
  }
  view_ = found.back().view;
  update_.UpdateSeen(buffer_.extent, options_.ratio, &buffer_);
  Iterate(buffer_.extent, kRevisitIterations, regularisation_.Weight(buffer_.extent, buffer_, noise_sigma));
}

}  // namespace trem
