#include "mosaic/composite/median.h"

#include <algorithm>
#include <cmath>

#include "mosaic/base/check.h"

namespace trem {
namespace {

bool InTotalOrder(const WeightedSample& a, const WeightedSample& b) {
  if (a.value != b.value) return a.value < b.value;
  return a.source < b.source;
}

// The strict weighted median of sorted samples: the mean of the lower and the upper one.
double StrictMedian(std::span<const WeightedSample> sorted, double total) {
  const double half = 0.5 * total;
  double below = 0.0;
  for (std::size_t i = 0; i < sorted.size(); ++i) {
    below += sorted[i].weight;
    if (below > half || i + 1 == sorted.size()) return sorted[i].value;
    if (below == half) return 0.5 * (static_cast<double>(sorted[i].value) + static_cast<double>(sorted[i + 1].value));
  }
  return sorted.back().value;
}

}  // namespace

float WeightedMedian(std::span<WeightedSample> samples, const MedianOptions& options) {
  TREM_CHECK(!samples.empty());
  TREM_CHECK(options.blend >= 0.0 && options.blend < 0.5);
  if (samples.size() == 1) return samples[0].value;
  std::sort(samples.begin(), samples.end(), InTotalOrder);
  double total = 0.0;
  for (const WeightedSample& sample : samples) total += sample.weight;
  if (options.blend == 0.0) return static_cast<float>(StrictMedian(samples, total));

  const double low = (0.5 - options.blend) * total;
  const double high = (0.5 + options.blend) * total;
  // Summed as differences to the first value that takes part: when only one does, the result is that value exactly.
  double below = 0.0, sum = 0.0, base = 0.0;
  bool started = false;
  for (const WeightedSample& sample : samples) {
    const double above = below + sample.weight;
    const double part = std::min(above, high) - std::max(below, low);
    if (part > 0.0) {
      if (!started) base = sample.value;
      started = true;
      sum += part * (sample.value - base);
    }
    below = above;
    if (below >= high) break;
  }
  return static_cast<float>(base + sum / (high - low));
}

PixelMedian ReducePixel(std::span<WeightedSample> samples, const MedianOptions& options) {
  PixelMedian result;
  result.count = static_cast<int>(samples.size());
  result.median = WeightedMedian(samples, options);
  const WeightedSample* dominant = &samples[0];
  for (const WeightedSample& sample : samples) {
    if (sample.weight > dominant->weight || (sample.weight == dominant->weight && sample.source < dominant->source)) dominant = &sample;
  }
  result.source = dominant->source;
  for (WeightedSample& sample : samples) sample.value = std::abs(sample.value - result.median);
  result.nmad = static_cast<float>(kNmadPerMad * WeightedMedian(samples, options));
  return result;
}

}  // namespace trem
