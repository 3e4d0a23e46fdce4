#include "worker/telemetry/time_offset.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace trem {
namespace {

constexpr int kPairsMin = 20;
constexpr double kSigmaMax_s = 0.1;
constexpr double kGainMin = 0.9;
constexpr double kHuber = 1.5;
constexpr double kCorrelatedPairs = 4.0;
constexpr std::size_t kPairsMax = 2000;

double Median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

class Estimator {
 public:
  Estimator(const TelemetryTrack& track, const std::vector<MeasuredMotion>& motions, const TimeOffsetOptions& options)
      : track_(track), options_(options), steps_(static_cast<int>(std::lround(options.range_s / options.step_s))) {
    const std::size_t stride = (motions.size() + kPairsMax - 1) / kPairsMax;
    for (std::size_t i = 0; i < motions.size(); i += std::max<std::size_t>(1, stride)) {
      if (SeenThroughout(motions[i])) motions_.push_back(motions[i]);
    }
  }

  TimeOffset Estimate() {
    TimeOffset result;
    result.pairs = static_cast<int>(motions_.size());
    if (result.pairs < kPairsMin) {
      result.reason =
          fmt::format("{} pairs of frames lie within the telemetry at every offset; expected {} or more", result.pairs, kPairsMin);
      return result;
    }
    double least = std::numeric_limits<double>::infinity();
    int best = 0;
    for (int k = -steps_; k <= steps_; ++k) {
      const double spread = Spread(k * options_.step_s);
      if (spread < least) {
        least = spread;
        best = k;
      }
    }
    result.rms_px = least;
    result.rms_at_zero_px = Spread(0.0);
    if (std::abs(best) == steps_) {
      result.reason = fmt::format("the fit is best at the end of the range of +-{:g} s", options_.range_s);
      return result;
    }
    Refine(best, least, &result);
    return result;
  }

 private:
  // Predictable whatever the offset, so that all offsets are judged by the same pairs.
  bool SeenThroughout(const MeasuredMotion& motion) const {
    const double low = std::min(motion.previous_time_s, motion.time_s) - options_.range_s;
    const double high = std::max(motion.previous_time_s, motion.time_s) + options_.range_s;
    return !track_.empty() && low >= track_.samples().front().time_s && high <= track_.samples().back().time_s &&
           Predict(motion, 0.0).has_value();
  }

  std::optional<Eigen::Vector2d> Predict(const MeasuredMotion& motion, double offset_s) const {
    const std::optional<Homography> now = GroundFromFrameAt(track_, motion.time_s + offset_s, options_.geometry);
    const std::optional<Homography> before = GroundFromFrameAt(track_, motion.previous_time_s + offset_s, options_.geometry);
    const Eigen::Vector2d middle = options_.geometry.middle();
    if (!now.has_value() || !before.has_value()) return std::nullopt;
    return Eigen::Vector2d(before->Inverse() * (*now * middle) - middle);
  }

  // Robust rms of the residuals (of both coordinates together) at an offset.
  double Spread(double offset_s) const {
    std::vector<double> misses;
    misses.reserve(motions_.size());
    for (const MeasuredMotion& motion : motions_) {
      const std::optional<Eigen::Vector2d> predicted = Predict(motion, offset_s);
      if (predicted.has_value()) misses.push_back((motion.shift_px - *predicted).norm());
    }
    if (2 * misses.size() < motions_.size()) return std::numeric_limits<double>::infinity();
    const double scale = std::max(1e-3, Median(misses));
    double sum = 0.0;
    for (const double miss : misses) {
      const double u = miss / (kHuber * scale);
      sum += u <= 1.0 ? u * u : 2.0 * u - 1.0;
    }
    return kHuber * scale * std::sqrt(sum / static_cast<double>(misses.size()));
  }

  void Refine(int best, double least, TimeOffset* result) const {
    const double h = options_.step_s;
    const double below = Spread((best - 1) * h);
    const double above = Spread((best + 1) * h);
    // Of the sums of squares, which are parabolas near the minimum.
    const double f0 = least * least;
    const double bend = (below * below - 2.0 * f0 + above * above) / (h * h);
    result->offset_s = best * h;
    if (!(bend > 0.0) || !std::isfinite(bend)) {
      result->reason = "the fit does not depend on the offset";
      return;
    }
    const double slope = (above * above - below * below) / (2.0 * h);
    result->offset_s -= std::clamp(slope / bend, -h, h);
    // Chi-squared is n f / f0 (two coordinates share f0) and rises by 1 at one sigma: n bend sigma^2 / (2 f0) = 1.
    const double independent = static_cast<double>(result->pairs) / kCorrelatedPairs;
    result->sigma_s = std::sqrt(2.0 * f0 / (independent * bend));
    if (result->sigma_s > kSigmaMax_s) {
      result->reason = fmt::format("the camera moves too evenly: the offset has a standard error of {:.2f} s", result->sigma_s);
    } else if (result->rms_px > kGainMin * result->rms_at_zero_px) {
      result->reason = fmt::format("none is needed: {:+.3f} +- {:.3f} s fits hardly better ({:.2f} px) than none ({:.2f} px)",
                                   result->offset_s, result->sigma_s, result->rms_px, result->rms_at_zero_px);
    } else {
      result->determined = true;
    }
  }

  const TelemetryTrack& track_;
  const TimeOffsetOptions& options_;
  int steps_;
  std::vector<MeasuredMotion> motions_;
};

}  // namespace

TimeOffset EstimateTimeOffset(const TelemetryTrack& track, const std::vector<MeasuredMotion>& motions, const TimeOffsetOptions& options) {
  TREM_CHECK(options.geometry.width_px > 0 && options.geometry.height_px > 0 && options.step_s > 0.0);
  return Estimator(track, motions, options).Estimate();
}

}  // namespace trem
