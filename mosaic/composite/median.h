#pragma once

#include <cstdint>
#include <span>

namespace trem {

// One scene's opinion about a pixel.
struct WeightedSample {
  float value = 0.0f;
  float weight = 0.0f;       // > 0.
  std::uint32_t source = 0;  // Distinct within a pixel; breaks ties.
};

struct MedianOptions {
  // Half width of the central part of the weight that is averaged, [0, 0.5). With q(p) the weighted quantile function, the result is
  //
  //   m = 1 / (2 b) * integral of q(p) dp over [1/2 - b, 1/2 + b]
  //
  // At 0 it is the weighted median (the mean of lower and upper median where the weight splits evenly). With b > 0 it is continuous in
  // the weights, so that a seam between two scenes fades over the zone where their weights are alike instead of stepping, and it still
  // resists up to 1/2 - b of the weight being wrong: with equal weights and an odd number n <= 1 / (2 b) of samples, or n even and
  // n <= 1 / b, it IS the median.
  double blend = 0.1;
};

struct PixelMedian {
  float median = 0.0f;
  float nmad = 0.0f;         // 1.4826 * weighted median of |value - median|: the standard deviation if noise is Gaussian.
  int count = 0;             // Samples.
  std::uint32_t source = 0;  // Of the largest weight; the least source among equals.
};

inline constexpr double kNmadPerMad = 1.4826;

// Weighted median of at least one sample. Samples are put into the total order (value, source) first (in place), so that the result
// does not depend on the order in which they come. All values and weights finite, weights > 0. Cost: n log n.
float WeightedMedian(std::span<WeightedSample> samples, const MedianOptions& options);

// Median, spread and source. `samples` is scratch: overwritten.
PixelMedian ReducePixel(std::span<WeightedSample> samples, const MedianOptions& options);

}  // namespace trem
