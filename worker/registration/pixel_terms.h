#pragma once

#include <span>
#include <vector>

#include "worker/registration/gauss_newton.h"
#include "worker/registration/pixel_sums.h"
#include "worker/registration/target.h"

namespace trem {

// Where Huber's loss turns linear, in standard deviations; the same in every registration method.
inline constexpr double kHuberSigmas = 3.0;
// What a pixel without scene behind it costs, in units of -log p: as much as one that is off by twice Huber's corner. Leaving the scene is
// then never an advantage.
inline constexpr double kMissingCost = 1.5 * kHuberSigmas * kHuberSigmas;

// The pixels of a frame at one resolution as terms of a likelihood, held ready for many evaluations at different views. Not for use by
// several threads at once: an evaluation leaves its samples in the object.
class PixelTerms {
 public:
  // `reductions` halvings of the frame (and one more of the prediction, which at three cells a pixel is the nearest to the same blur);
  // a regular grid of about `terms_about` pixels of it, all for 0. Pixels that are NaN or have weight 0 are left out.
  PixelTerms(const Observation& observation, const Reference& reference, int reductions, int terms_about);
  PixelTerms(const PixelTerms&) = delete;
  PixelTerms& operator=(const PixelTerms&) = delete;

  int count() const { return count_; }
  // Sum of the weights of all terms: 1 each without Observation::weights.
  double weight() const { return weight_; }

  // Terms in places that follow each other: padded to whole blocks.
  struct Range {
    std::size_t begin = 0;
    std::size_t end = 0;
  };
  Range All() const { return {0, all_end_}; }
  // Copies these terms to places of their own, so that they are evaluated without jumping about.
  Range Append(std::span<const int> terms);

  // Samples the prediction at the terms of `range`; what follows speaks of these samples.
  void Sample(const Range& range, const View& view);
  // Weighted moments of I - gain P - offset and P, of `range`, with the factors that FreezeRobustFactors left.
  PixelMoments Moments(const Range& range, double gain, double offset) const;
  // -log p of the pixels up to a constant: Huber's loss at this gain and offset, and the cost of missing pixels.
  double Cost(const Range& range, double gain, double offset, double sigma) const;
  // Huber's weights at the present samples of All() become factors of Moments until the next call; copies made by Append have them too.
  void FreezeRobustFactors(double gain, double offset, double sigma);

 private:
  PixelSpan SpanOf(const Range& range) const;

  Image<float> reduced_prediction_;
  Image<float> reduced_seen_;
  PredictionGrid grid_;
  Eigen::Matrix3d grid_from_scene_ = Eigen::Matrix3d::Identity();
  Roi roi_;
  int count_ = 0;
  double weight_ = 0.0;
  std::size_t all_end_ = 0;
  std::vector<float> x_;  // Sensor pixels from the ROI's corner; then by place, like all that follow.
  std::vector<float> y_;
  std::vector<float> intensity_;
  std::vector<float> used_weight_;
  std::vector<float> factor_;
  std::vector<int> term_of_place_;
  std::vector<float> value_;
  std::vector<float> trust_;
};

// What is known of gain and offset given a view's moments, under the prior of `prior` and the noise `sigma` (a Gaussian model: Moments
// carries no Huber's loss beyond its frozen factors). `moments` are those at the prior's mean gain and offset.
struct GainOffsetPosterior {
  double gain = 1.0;    // Maximum a posteriori: the weighted least squares fit.
  double offset = 0.0;
  Eigen::Matrix2d covariance;
  // log of the integral of p(pixels | view, gain, offset) p(gain, offset) over gain and offset, up to a constant of the pixels.
  double log_marginal = 0.0;
};
GainOffsetPosterior FitGainOffset(const PixelMoments& moments, const ViewPrior& prior, double sigma);

}  // namespace trem
