#include "worker/tre/brightness.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace trem {
namespace {

// Some 600 samples of a ROI tell a percentile to a fiftieth of the spread.
constexpr double kSamplesAbout = 600.0;
constexpr std::size_t kSamplesMin = 64;
// Jumps from which the start of a registration is moved.
constexpr double kGainJump = 1.3;
constexpr double kShiftJump = 25.0;  // Internal grey levels.
// Spread [noise sigmas] that a gain can be read from.
constexpr double kSpreadSigmas = 6.0;

// 10, 50 and 90 %.
std::array<double, 3> Percentiles(std::vector<float>* values) {
  const auto at = [&](double part) {
    return values->begin() + static_cast<std::ptrdiff_t>(part * static_cast<double>(values->size() - 1));
  };
  const auto low = at(0.1);
  const auto middle = at(0.5);
  const auto high = at(0.9);
  // The median parts them in two halves, in which the others are.
  std::nth_element(values->begin(), middle, values->end());
  std::nth_element(values->begin(), low, middle);
  std::nth_element(middle, high, values->end());
  return {*low, *middle, *high};
}

}  // namespace

std::optional<Brightness> BrightnessJump(const Observation& observation, const Reference& reference, const View& expected) {
  std::vector<float> seen;
  std::vector<float> predicted;
  const Roi& roi = observation.roi;
  const Image<float>& prediction = *reference.prediction;
  const int stride = std::max(1, static_cast<int>(std::sqrt(static_cast<double>(roi.area()) / kSamplesAbout)));
  for (int v = stride / 2; v < roi.height(); v += stride) {
    for (int u = stride / 2; u < roi.width(); u += stride) {
      const float value = observation.roi_pixels->at(u, v);
      if (std::isnan(value) || !(observation.weight(u, v) > 0.0F)) continue;
      const Eigen::Vector2d cell = expected.scene_from_sensor * Eigen::Vector2d(roi.x0 + u, roi.y0 + v);
      const double x = cell.x() - reference.x0 + 0.5;
      const double y = cell.y() - reference.y0 + 0.5;
      if (!(x >= 0.0 && y >= 0.0 && x < prediction.width() && y < prediction.height())) continue;
      const int cx = static_cast<int>(x);
      const int cy = static_cast<int>(y);
      if (!(reference.seen->at(cx, cy) >= reference.seen_min)) continue;
      seen.push_back(value);
      predicted.push_back(prediction.at(cx, cy));
    }
  }
  if (seen.size() < kSamplesMin) return std::nullopt;
  const auto [i10, i50, i90] = Percentiles(&seen);
  const auto [p10, p50, p90] = Percentiles(&predicted);
  const double shift = i50 - (expected.gain * p50 + expected.offset);
  const double least = kSpreadSigmas * observation.noise_sigma;
  const bool textured = i90 - i10 > least && expected.gain * (p90 - p10) > least;
  const double gain = textured ? (i90 - i10) / (p90 - p10) : expected.gain;
  const double step = gain / expected.gain;
  if (step < kGainJump && step > 1.0 / kGainJump && std::abs(shift) < kShiftJump) return std::nullopt;
  if (!(gain > 0.1 && gain < 10.0)) return std::nullopt;
  return Brightness{gain, i50 - gain * p50};
}

}  // namespace trem
