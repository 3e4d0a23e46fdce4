#include "mosaic/composite/median.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "mosaic/base/check.h"

namespace trem {
namespace {

bool InTotalOrder(const WeightedSample& a, const WeightedSample& b) {
  if (a.value != b.value) return a.value < b.value;
  return a.weight < b.weight;
}

float TotalWeight(std::span<const WeightedSample> sorted) {
  float total = 0.0f;
  for (const WeightedSample& sample : sorted) total += sample.weight;
  return total;
}

// The strict weighted median of sorted samples: the mean of the lower and the upper one.
float StrictMedian(std::span<const WeightedSample> sorted) {
  const float half = 0.5f * TotalWeight(sorted);
  float below = 0.0f, lower = 0.0f, upper = 0.0f;
  bool has_lower = false, has_upper = false;
  for (const WeightedSample& sample : sorted) {
    below += sample.weight;
    if (!has_lower && below >= half) lower = sample.value;
    if (!has_upper && below > half) upper = sample.value;
    has_lower = has_lower || below >= half;
    has_upper = has_upper || below > half;
  }
  return 0.5f * (lower + upper);
}

float BlendedMedian(std::span<const WeightedSample> sorted, float blend) {
  const float total = TotalWeight(sorted);
  const float low = (0.5f - blend) * total;
  const float high = (0.5f + blend) * total;
  // Summed as differences to the first value that takes part: when only one does, the result is that value exactly.
  float below = 0.0f, sum = 0.0f, base = 0.0f;
  bool started = false;
  for (const WeightedSample& sample : sorted) {
    const float above = below + sample.weight;
    const float part = std::min(above, high) - std::max(below, low);
    if (part > 0.0f) {
      if (!started) base = sample.value;
      started = true;
      sum += part * (sample.value - base);
    }
    below = above;
  }
  return base + sum / (high - low);
}

float SortedMedian(std::span<const WeightedSample> sorted, double blend) {
  return blend == 0.0 ? StrictMedian(sorted) : BlendedMedian(sorted, static_cast<float>(blend));
}

// The step of the biweight from `median`; `mad` is the median absolute deviation from it.
float BiweightStep(std::span<const WeightedSample> sorted, float median, float mad, float floor) {
  const float scale = kBiweightCutoff * mad + floor;
  if (!(scale > 0.0f)) return median;
  float sum = 0.0f, total = 0.0f;
  for (const WeightedSample& sample : sorted) {
    const float deviation = sample.value - median;
    const float u = deviation / scale;
    const float trust = std::max(1.0f - u * u, 0.0f);
    const float weight = sample.weight * (trust * trust);
    sum += weight * deviation;
    total += weight;
  }
  return total > 0.0f ? median + sum / total : median;
}

}  // namespace

float WeightedMedian(std::span<WeightedSample> samples, const MedianOptions& options) {
  TREM_CHECK(!samples.empty());
  TREM_CHECK(options.blend >= 0.0 && options.blend < 0.5);
  std::sort(samples.begin(), samples.end(), InTotalOrder);
  return SortedMedian(samples, options.blend);
}

PixelMedian ReducePixel(std::span<WeightedSample> samples, const MedianOptions& options) {
  TREM_CHECK(!samples.empty());
  PixelMedian result;
  result.count = static_cast<int>(samples.size());
  const WeightedSample* dominant = &samples[0];
  for (const WeightedSample& sample : samples) {
    if (sample.weight > dominant->weight || (sample.weight == dominant->weight && sample.source < dominant->source)) dominant = &sample;
  }
  result.source = dominant->source;
  const double blend = options.estimator == Estimator::kMedian ? 0.0 : options.blend;
  if (options.estimator == Estimator::kMedian) {
    for (WeightedSample& sample : samples) sample.weight = 1.0f;
  }
  result.median = WeightedMedian(samples, {blend});
  const std::vector<WeightedSample> sorted(samples.begin(), samples.end());
  for (WeightedSample& sample : samples) sample.value = std::abs(sample.value - result.median);
  const float mad = WeightedMedian(samples, {blend});
  result.nmad = static_cast<float>(kNmadPerMad) * mad;
  if (options.estimator == Estimator::kBiweight)
    result.median = BiweightStep(sorted, result.median, mad, static_cast<float>(options.biweight_floor));
  return result;
}

}  // namespace trem
