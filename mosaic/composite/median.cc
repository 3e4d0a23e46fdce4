#include "mosaic/composite/median.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "mosaic/base/check.h"

namespace trem {
namespace {

// A sample with the weight of those that come before it in the order (value, source).
struct RankedSample {
  float value;
  float weight;
  float below;
};

// `samples` sorted by source. Sums run by source too: that is an order which vectors of any length can keep without sorting.
std::vector<RankedSample> Rank(std::span<const WeightedSample> samples) {
  std::vector<RankedSample> ranked;
  ranked.reserve(samples.size());
  for (std::size_t i = 0; i < samples.size(); ++i) {
    float below = 0.0f;
    for (std::size_t j = 0; j < samples.size(); ++j) {
      const bool before = j < i ? samples[j].value <= samples[i].value : samples[j].value < samples[i].value;
      if (before) below += samples[j].weight;
    }
    ranked.push_back({samples[i].value, samples[i].weight, below});
  }
  return ranked;
}

float TotalWeight(std::span<const RankedSample> samples) {
  float total = 0.0f;
  for (const RankedSample& sample : samples) total += sample.weight;
  return total;
}

// The strict weighted median: the mean of the lower and the upper one.
float StrictMedian(std::span<const RankedSample> samples) {
  const float half = 0.5f * TotalWeight(samples);
  float lower = std::numeric_limits<float>::max(), upper = lower;
  for (const RankedSample& sample : samples) {
    const float above = sample.below + sample.weight;
    if (above >= half) lower = std::min(lower, sample.value);
    if (above > half) upper = std::min(upper, sample.value);
  }
  return 0.5f * (lower + upper);
}

float BlendedMedian(std::span<const RankedSample> samples, float blend) {
  const float total = TotalWeight(samples);
  const float low = (0.5f - blend) * total;
  const float high = (0.5f + blend) * total;
  const auto part = [&](const RankedSample& sample) {
    return std::min(std::max(sample.below + sample.weight, low), high) - std::min(std::max(sample.below, low), high);
  };
  // Summed as differences to a value that takes part: when only one does, the result is that value exactly.
  float base = 0.0f, sum = 0.0f;
  for (const RankedSample& sample : samples) {
    if (part(sample) > 0.0f) base = sample.value;
  }
  for (const RankedSample& sample : samples) sum += part(sample) * (sample.value - base);
  return base + sum / (high - low);
}

bool BySource(const WeightedSample& a, const WeightedSample& b) { return a.source < b.source; }

// The step of the biweight from `median`; `mad` is the median absolute deviation from it.
float BiweightStep(std::span<const WeightedSample> samples, float median, float mad, float floor) {
  const float scale = kBiweightCutoff * mad + floor;
  if (!(scale > 0.0f)) return median;
  float sum = 0.0f, total = 0.0f;
  for (const WeightedSample& sample : samples) {
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
  std::sort(samples.begin(), samples.end(), BySource);
  const std::vector<RankedSample> ranked = Rank(samples);
  return options.blend == 0.0 ? StrictMedian(ranked) : BlendedMedian(ranked, static_cast<float>(options.blend));
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
  const std::vector<WeightedSample> by_source(samples.begin(), samples.end());
  for (WeightedSample& sample : samples) sample.value = std::abs(sample.value - result.median);
  const float mad = WeightedMedian(samples, {blend});
  result.nmad = static_cast<float>(kNmadPerMad) * mad;
  if (options.estimator == Estimator::kBiweight)
    result.median = BiweightStep(by_source, result.median, mad, static_cast<float>(options.biweight_floor));
  return result;
}

}  // namespace trem
