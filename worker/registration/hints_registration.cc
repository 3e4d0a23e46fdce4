#include "worker/registration/hints_registration.h"

#include <Eigen/Cholesky>
#include <cmath>
#include <vector>

#include "worker/registration/hints.h"
#include "worker/registration/reduce.h"
#include "worker/sensor/bicubic.h"

namespace trem {
namespace {

constexpr int kTermsAbout = 1024;
constexpr double kHuberSigmas = 3.0;
constexpr double kGainStep = 0.03;    // Scale of the capture search, relative and in grey levels.
constexpr double kOffsetStep = 3.0;

View ViewAt(const ViewPrior& prior, const Roi& roi, const HintsState& x) {
  return {Displace(prior.mean.scene_from_sensor, roi, CornerVector(x.head<6>())), prior.mean.gain + x(6), prior.mean.offset + x(7)};
}

// log p(pixel | view) of a grid of pixels at one resolution.
class PixelTarget : public AdditiveTarget {
 public:
  PixelTarget(const Observation& observation, const Reference& reference, const ViewPrior& prior, int reductions, double sigma)
      : observation_(observation), reference_(reference), prior_(prior), sigma_(sigma), frame_(*observation.roi_pixels),
        prediction_(*reference.prediction), seen_(*reference.seen) {
    for (int l = 0; l < reductions; ++l) frame_ = ReduceByTwo(frame_);
    // One halving more than the frame: at three cells a pixel the nearest to the same blur.
    for (int l = 0; l < (reductions > 0 ? reductions + 1 : 0); ++l) {
      prediction_ = ReduceByTwo(prediction_);
      seen_ = ReduceByTwoMinimum(seen_);
    }
    frame_step_ = 1 << reductions;
    reference_step_ = reductions > 0 ? 2.0 * frame_step_ : 1.0;
    const double area = static_cast<double>(frame_.width()) * frame_.height();
    const int stride = std::max(1, static_cast<int>(std::floor(std::sqrt(area / kTermsAbout))));
    for (int v = stride / 2; v < frame_.height(); v += stride) {
      for (int u = stride / 2; u < frame_.width(); u += stride) {
        if (!std::isnan(frame_.at(u, v))) pixels_.push_back({u, v});
      }
    }
  }

  int term_count() const override { return static_cast<int>(pixels_.size()); }

  double LogTerms(std::span<const int> terms, const HintsState& x) const override {
    const View view = ViewAt(prior_, observation_.roi, x);
    double sum = 0.0;
    for (const int term : terms) {
      const Pixel pixel = pixels_[static_cast<std::size_t>(term)];
      const Eigen::Vector2d sensor(observation_.roi.x0 + pixel.u * frame_step_ + 0.5 * (frame_step_ - 1.0),
                                   observation_.roi.y0 + pixel.v * frame_step_ + 0.5 * (frame_step_ - 1.0));
      const Eigen::Vector2d scene = view.scene_from_sensor * sensor;
      const double cx = (scene.x() - reference_.x0 - 0.5 * (reference_step_ - 1.0)) / reference_step_;
      const double cy = (scene.y() - reference_.y0 - 0.5 * (reference_step_ - 1.0)) / reference_step_;
      double sigmas = 2.0 * kHuberSigmas;
      if (CubicSupported(prediction_, cx, cy) && seen_.at(static_cast<int>(cx + 0.5), static_cast<int>(cy + 0.5)) >= reference_.seen_min) {
        sigmas = std::abs(frame_.at(pixel.u, pixel.v) - view.gain * SampleCubic(prediction_, cx, cy) - view.offset) / sigma_;
      }
      sum -= sigmas <= kHuberSigmas ? 0.5 * sigmas * sigmas : kHuberSigmas * (sigmas - 0.5 * kHuberSigmas);
    }
    return sum;
  }

  double LogPrior(const HintsState& x) const override {
    const CornerVector d = x.head<6>();
    const double gain = x(6) / prior_.gain_sigma;
    const double offset = x(7) / prior_.offset_sigma;
    return -0.5 * (d.dot(prior_.information.topLeftCorner<6, 6>() * d) + gain * gain + offset * offset);
  }

 private:
  struct Pixel {
    int u;
    int v;
  };
  const Observation& observation_;
  const Reference& reference_;
  const ViewPrior& prior_;
  double sigma_;
  Image<float> frame_;
  Image<float> prediction_;
  Image<float> seen_;
  double frame_step_ = 1.0;
  double reference_step_ = 1.0;
  std::vector<Pixel> pixels_;
};

// Proposal shape of the search: a common translation of 4 px, 1 px a corner, a little gain and offset.
HintsMatrix CaptureShape() {
  HintsMatrix covariance = HintsMatrix::Zero(8, 8);
  for (int a = 0; a < 3; ++a) {
    for (int b = 0; b < 3; ++b) covariance.block<2, 2>(2 * a, 2 * b) = Eigen::Matrix2d::Identity() * (16.0 + (a == b ? 1.0 : 0.0));
  }
  covariance(6, 6) = kGainStep * kGainStep;
  covariance(7, 7) = kOffsetStep * kOffsetStep;
  return covariance.llt().matrixL();
}

}  // namespace

Registration RegisterHints(const Observation& observation, const Reference& reference, const ViewPrior& prior, HintsUse use,
                           const std::uint64_t (&stream)[3]) {
  const bool full = use == HintsUse::kFull;
  const PixelTarget target(observation, reference, prior, full ? 0 : 2, (full ? 1.0 : 3.0) * observation.noise_sigma);
  HintsOptions options;
  options.seed_key = {stream[0], stream[1], stream[2]};
  options.sweeps = full ? 40 : 60;
  Registration laplace = EvaluateView(observation, reference, prior, prior.mean);
  HintsMatrix shape = CaptureShape();
  if (full && laplace.overlap > 0.0) {
    HintsMatrix covariance = HintsMatrix::Zero(8, 8);
    covariance.topLeftCorner<6, 6>() = laplace.corner_covariance.topLeftCorner<6, 6>();
    covariance.bottomRightCorner<2, 2>() = laplace.gain_offset_covariance;
    const Eigen::LLT<HintsMatrix> cholesky(covariance);
    if (cholesky.info() == Eigen::Success) shape = cholesky.matrixL();
  }
  if (target.term_count() < options.leaf_size) return laplace;
  const Result<HintsResult> draws = RunHints(target, HintsState::Zero(8), shape, options);
  if (!draws.ok()) return laplace;
  const View view = ViewAt(prior, observation.roi, full ? draws->mean : draws->best);
  Registration registration = EvaluateView(observation, reference, prior, view);
  registration.converged = registration.overlap > 0.0;
  if (full) registration.corner_covariance.topLeftCorner<6, 6>() = draws->covariance.topLeftCorner<6, 6>();
  return registration;
}

}  // namespace trem
