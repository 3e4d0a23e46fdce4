#pragma once

#include <cstdint>
#include <span>

namespace trem {

// One scene's opinion about a pixel.
struct WeightedSample {
  float value = 0.0f;
  float weight = 0.0f;       // > 0.
  std::uint32_t source = 0;  // Distinct within a pixel; orders sums and breaks ties.
};

// How the samples of a pixel become one value.
enum class Estimator {
  kWeightedMedian,  // The weighted median, blended (below): resists up to 1/2 - blend of the weight being wrong.
  kMedian,          // Every sample one vote, whatever its weight. Seams do not fade.
  // One step of Tukey's biweight from the blended weighted median m, with w the samples' weights and s their weighted median absolute
  // deviation from m (Mosteller & Tukey, "Data analysis and regression", 1977, ch. 10):
  //
  //   m + sum w (1 - u^2)^2 (x - m) / sum w (1 - u^2)^2 over |u| < 1,   u = (x - m) / (c s + floor)
  //
  // Averages the samples that agree, so that noise is lower than the median's, and leaves out what is c deviations and the floor away.
  kBiweight,
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
  Estimator estimator = Estimator::kWeightedMedian;
  // kBiweight: what samples may always differ by (noise, what balancing left over), in the values' unit. Larger: seams fade more surely,
  // weak movers are averaged in. At 0 two samples of which one fades out against the other jump.
  double biweight_floor = 6.0;
};

struct PixelMedian {
  float median = 0.0f;  // Whatever the estimator.
  float nmad = 0.0f;    // 1.4826 * weighted median of |value - m|: the standard deviation if noise is Gaussian. m: the weighted median.
  int count = 0;        // Samples.
  std::uint32_t source = 0;  // Of the largest weight; the least source among equals.
};

inline constexpr double kNmadPerMad = 1.4826;
// Tukey's c: samples beyond that many median absolute deviations do not count (about 4 standard deviations of Gaussian noise).
inline constexpr float kBiweightCutoff = 6.0f;

// Weighted median of at least one sample. They are put in the order of their sources first (in place): sums run in that order and it
// breaks ties between values, so that the result does not depend on the order in which samples come. All values and weights finite,
// weights > 0. Cost: n^2; it is the reference of ReduceRow (reduce_row.h), which gives the same bytes. In float32, one operation after the
// other.
float WeightedMedian(std::span<WeightedSample> samples, const MedianOptions& options);

// Value, spread and source of at least one sample. `samples` is scratch: reordered, and overwritten. NMAD is about the weighted median
// for every estimator but kMedian, where every sample has one vote in both.
PixelMedian ReducePixel(std::span<WeightedSample> samples, const MedianOptions& options);

}  // namespace trem
