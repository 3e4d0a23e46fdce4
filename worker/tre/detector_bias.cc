#include "worker/tre/detector_bias.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace trem {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr int kGaugeReach = 8;
constexpr double kTurnPx = 2.0;
// Turns of each half before anything is concluded, and frames between two estimates.
constexpr int kTurnsMin = 2;
constexpr int kEstimateEvery = 4;
// AUTO: least spread of a pattern in noise sigmas that is corrected, and least correlation of the two halves.
constexpr double kSpreadMin = 0.25;
constexpr double kCorrelationMin = 0.1;
constexpr double kRobustSigmas = 3.0;
constexpr double kRevisitFactor = 0.25;
constexpr double kAgreeSizes = 5.0;

struct Agreement {
  double covariance = 0.0;
  double correlation = 0.0;
  long long pixels = 0;
};

double MeanSize(const Image<float>& image) {
  double sum = 0.0;
  for (const float value : image.pixels()) sum += std::abs(value);
  return sum / static_cast<double>(image.pixels().size());
}

// Of two images of zero mean. Values beyond kAgreeSizes mean sizes (4 sigma of a Gaussian) are left out: a few bad pixels are no pattern.
Agreement Agree(const Image<float>& a, const Image<float>& b) {
  const float limit = static_cast<float>(kAgreeSizes * std::max(MeanSize(a), MeanSize(b)));
  double ab = 0.0;
  double aa = 0.0;
  double bb = 0.0;
  Agreement agreement;
  for (int y = 0; y < a.height(); ++y) {
    const float* p = a.row(y);
    const float* q = b.row(y);
    for (int x = 0; x < a.width(); ++x) {
      if (p[x] == 0.0F || q[x] == 0.0F) continue;  // Not measured by both.
      if (std::abs(p[x]) > limit || std::abs(q[x]) > limit) continue;
      ++agreement.pixels;
      ab += static_cast<double>(p[x]) * q[x];
      aa += static_cast<double>(p[x]) * p[x];
      bb += static_cast<double>(q[x]) * q[x];
    }
  }
  if (agreement.pixels == 0 || !(aa > 0.0) || !(bb > 0.0)) return agreement;
  agreement.covariance = ab / static_cast<double>(agreement.pixels);
  agreement.correlation = ab / std::sqrt(aa * bb);
  return agreement;
}

Image<float> MeanOf(const Image<float>& weight, const Image<float>& weighted) {
  Image<float> mean(weight.width(), weight.height());
  for (std::size_t i = 0; i < mean.pixels().size(); ++i) {
    mean.pixels()[i] = weight.pixels()[i] > 0.0F ? weighted.pixels()[i] / weight.pixels()[i] : kNan;
  }
  return mean;
}

}  // namespace

void RemoveLocalMean(int reach, Image<float>* image) {
  const int width = image->width();
  const int height = image->height();
  // Sums over columns of 2 reach + 1 rows slide down, and their sums over columns slide right.
  std::vector<double> sums(static_cast<std::size_t>(width), 0.0);
  std::vector<int> counts(static_cast<std::size_t>(width), 0);
  const Image<float> source = *image;
  const auto add_row = [&](int y, int sign) {
    const float* row = source.row(y);
    for (int x = 0; x < width; ++x) {
      const bool usable = !std::isnan(row[x]);
      sums[static_cast<std::size_t>(x)] += usable ? sign * static_cast<double>(row[x]) : 0.0;
      counts[static_cast<std::size_t>(x)] += usable ? sign : 0;
    }
  };
  for (int y = 0; y < std::min(reach, height); ++y) add_row(y, 1);
  for (int y = 0; y < height; ++y) {
    if (y + reach < height) add_row(y + reach, 1);
    if (y - reach - 1 >= 0) add_row(y - reach - 1, -1);
    double sum = 0.0;
    int count = 0;
    for (int x = 0; x < std::min(reach, width); ++x) {
      sum += sums[static_cast<std::size_t>(x)];
      count += counts[static_cast<std::size_t>(x)];
    }
    float* out = image->row(y);
    for (int x = 0; x < width; ++x) {
      if (x + reach < width) {
        sum += sums[static_cast<std::size_t>(x + reach)];
        count += counts[static_cast<std::size_t>(x + reach)];
      }
      if (x - reach - 1 >= 0) {
        sum -= sums[static_cast<std::size_t>(x - reach - 1)];
        count -= counts[static_cast<std::size_t>(x - reach - 1)];
      }
      out[x] = std::isnan(out[x]) || count == 0 ? 0.0F : out[x] - static_cast<float>(sum / count);
    }
  }
}

DetectorBias::DetectorBias(int width, int height, Correction mode) : mode_(mode) {
  if (mode == Correction::kOff) return;
  const Image<float> blank(width, height);
  bias_ = blank;
  for (int half = 0; half < 2; ++half) weight_[half] = weighted_[half] = blank;
}

double DetectorBias::Learn(const FrameResidual& residual, const Eigen::Vector2d& centre, double noise_sigma) {
  if (mode_ == Correction::kOff) return 0.0;
  if (!has_centre_) turn_start_ = last_centre_ = centre;
  has_centre_ = true;
  const double step = (centre - last_centre_).norm();
  travel_px_ = std::max(travel_px_, (centre - turn_start_).norm() + kTurnPx * turns_);
  last_centre_ = centre;
  if ((centre - turn_start_).norm() > kTurnPx) {
    turn_start_ = centre;
    half_ = 1 - half_;
    ++turns_;
  }
  // A view that stands still over its scene says the same again: the scene has taken the pattern in.
  const float fresh = static_cast<float>(std::min(1.0, step));
  if (fresh > 0.02F) {
    const float spread2 = static_cast<float>(std::pow(std::max(sigma_, active_ ? 0.0 : 2.0 * noise_sigma), 2));
    for (int y = 0; y < bias_.height(); ++y) {
      const float* value = residual.value.row(y);
      const float* variance = residual.variance.row(y);
      const float* n = residual.frames_seen.row(y);
      const float* bias = bias_.row(y);
      float* w = weight_[half_].row(y);
      float* z = weighted_[half_].row(y);
      for (int x = 0; x < bias_.width(); ++x) {
        // A scene of few frames holds their pattern.
        const float explained = variance[x] + (active_ ? 0.0F : spread2 / std::max(n[x], 0.75F));
        const float limit = static_cast<float>(kRobustSigmas) * std::sqrt(explained + spread2);
        const bool usable = std::abs(value[x]) < 1e9F;  // Not when NaN.
        const float clipped = std::min(std::max(value[x], -limit), limit);
        const float weight = usable ? fresh / explained : 0.0F;
        w[x] += weight;
        z[x] += usable ? weight * (clipped + (active_ ? bias[x] : 0.0F)) : 0.0F;
      }
    }
    ++learned_;
  }
  if (learned_ > 0 && learned_ % kEstimateEvery == 0) Estimate(noise_sigma);
  return step;
}

void DetectorBias::Estimate(double noise_sigma) {
  if (!separable() || turns_ < 2 * kTurnsMin) return;
  Image<float> halves[2];
  for (int half = 0; half < 2; ++half) {
    halves[half] = MeanOf(weight_[half], weighted_[half]);
    RemoveLocalMean(kGaugeReach, &halves[half]);
  }
  const Agreement agreement = Agree(halves[0], halves[1]);
  const double spread = std::sqrt(std::max(agreement.covariance, 0.0));
  const bool shown =
      spread > kSpreadMin * noise_sigma && agreement.correlation > kCorrelationMin && 4 * agreement.pixels > bias_.width() * bias_.height();
  if (mode_ == Correction::kAuto && !active_ && !shown) return;
  if (!(spread > 0.0)) return;
  active_ = true;
  sigma_ = spread;
  const float prior = static_cast<float>(1.0 / (sigma_ * sigma_));
  for (std::size_t i = 0; i < bias_.pixels().size(); ++i) {
    const float weight = weight_[0].pixels()[i] + weight_[1].pixels()[i];
    bias_.pixels()[i] = weight > 0.0F ? (weighted_[0].pixels()[i] + weighted_[1].pixels()[i]) / (weight + prior) : kNan;
  }
  RemoveLocalMean(kGaugeReach, &bias_);
}

void DetectorBias::Revisit() {
  for (int half = 0; half < 2; ++half) {
    for (float& value : weight_[half].pixels()) value *= static_cast<float>(kRevisitFactor);
    for (float& value : weighted_[half].pixels()) value *= static_cast<float>(kRevisitFactor);
  }
  BreakTrack();
}

}  // namespace trem
