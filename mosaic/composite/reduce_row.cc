#include "mosaic/composite/reduce_row.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "mosaic/composite/reduce_row.cc"
#include <hwy/foreach_target.h>
// After foreach_target.h, which includes this file again for every target.
#include <hwy/highway.h>

#ifndef TREM_MOSAIC_COMPOSITE_REDUCE_ROW_ONCE
#define TREM_MOSAIC_COMPOSITE_REDUCE_ROW_ONCE
namespace trem::reduce {

// Sorts after every sample; with weight 0 it changes no sum.
inline constexpr float kAbsent = std::numeric_limits<float>::max();
inline constexpr std::size_t kUnrolledMax = 8;
inline constexpr std::size_t kLanesMax = 64;  // Floats of the widest vector that Highway knows, and more.

struct Exchange {
  std::uint8_t low = 0;
  std::uint8_t high = 0;
};

// Calls `exchange(i, j)`, i < j, for each step of Batcher's merge exchange of `n` elements.
template <typename F>
constexpr void ForEachExchange(std::size_t n, F exchange) {
  if (n < 2) return;
  std::size_t top = 1;
  while (2 * top < n) top *= 2;
  for (std::size_t p = top; p > 0; p /= 2) {
    std::size_t q = top, r = 0, d = p;
    for (;;) {
      for (std::size_t i = 0; i + d < n; ++i) {
        if ((i & p) == r) exchange(i, i + d);
      }
      if (q == p) break;
      d = q - p;
      q /= 2;
      r = p;
    }
  }
}

constexpr std::size_t ExchangeCount(std::size_t n) {
  std::size_t count = 0;
  ForEachExchange(n, [&count](std::size_t, std::size_t) { ++count; });
  return count;
}

template <std::size_t kRows>
constexpr auto NetworkOf() {
  std::array<Exchange, ExchangeCount(kRows)> network{};
  std::size_t at = 0;
  ForEachExchange(kRows, [&](std::size_t i, std::size_t j) {
    network[at++] = {static_cast<std::uint8_t>(i), static_cast<std::uint8_t>(j)};
  });
  return network;
}

// The network of any number of rows up to kNetworkRowsMax.
inline const std::vector<Exchange>& Network(std::size_t n) {
  static const auto* const networks = [] {
    auto* made = new std::array<std::vector<Exchange>, kNetworkRowsMax + 1>;
    for (std::size_t rows = 0; rows <= kNetworkRowsMax; ++rows) {
      ForEachExchange(rows, [&](std::size_t i, std::size_t j) {
        (*made)[rows].push_back({static_cast<std::uint8_t>(i), static_cast<std::uint8_t>(j)});
      });
    }
    return made;
  }();
  return (*networks)[n];
}

}  // namespace trem::reduce
#endif  // TREM_MOSAIC_COMPOSITE_REDUCE_ROW_ONCE

HWY_BEFORE_NAMESPACE();
namespace trem::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::ScalableTag<float>;
using V = hn::Vec<D>;
using reduce::Exchange;
using reduce::kAbsent;

// Samples of a block of pixels, one vector a row.
struct Block {
  HWY_ALIGN float value[kNetworkRowsMax * reduce::kLanesMax];
  HWY_ALIGN float weight[kNetworkRowsMax * reduce::kLanesMax];
  HWY_ALIGN float deviation[kNetworkRowsMax * reduce::kLanesMax];
  HWY_ALIGN float deviation_weight[kNetworkRowsMax * reduce::kLanesMax];
};

// Puts (va, wa) before (vb, wb) in the order (value, weight).
HWY_INLINE void OrderPair(V& va, V& wa, V& vb, V& wb) {
  const auto after = hn::Or(hn::Gt(va, vb), hn::And(hn::Eq(va, vb), hn::Gt(wa, wb)));
  const V low = hn::Min(va, vb);
  vb = hn::Max(va, vb);
  va = low;
  const V first = hn::IfThenElse(after, wb, wa);
  wb = hn::IfThenElse(after, wa, wb);
  wa = first;
}

template <std::size_t kRows, std::size_t... kSteps>
HWY_INLINE void SortUnrolled(float* value, float* weight, std::index_sequence<kSteps...>) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  constexpr auto kNetwork = reduce::NetworkOf<kRows>();
  V v[kRows];
  V w[kRows];
  for (std::size_t i = 0; i < kRows; ++i) v[i] = hn::Load(d, value + i * lanes);
  for (std::size_t i = 0; i < kRows; ++i) w[i] = hn::Load(d, weight + i * lanes);
  (OrderPair(v[kNetwork[kSteps].low], w[kNetwork[kSteps].low], v[kNetwork[kSteps].high], w[kNetwork[kSteps].high]), ...);
  for (std::size_t i = 0; i < kRows; ++i) hn::Store(v[i], d, value + i * lanes);
  for (std::size_t i = 0; i < kRows; ++i) hn::Store(w[i], d, weight + i * lanes);
}

template <std::size_t kRows, std::size_t... kSteps>
HWY_INLINE void SortValuesUnrolled(float* value, std::index_sequence<kSteps...>) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  constexpr auto kNetwork = reduce::NetworkOf<kRows>();
  V v[kRows];
  for (std::size_t i = 0; i < kRows; ++i) v[i] = hn::Load(d, value + i * lanes);
  const auto exchange = [&](V& a, V& b) HWY_ATTR {
    const V low = hn::Min(a, b);
    b = hn::Max(a, b);
    a = low;
  };
  (exchange(v[kNetwork[kSteps].low], v[kNetwork[kSteps].high]), ...);
  for (std::size_t i = 0; i < kRows; ++i) hn::Store(v[i], d, value + i * lanes);
}

template <std::size_t kRows>
HWY_INLINE void SortFew(float* value, float* weight) {
  constexpr auto kSteps = std::make_index_sequence<reduce::ExchangeCount(kRows)>();
  if (weight != nullptr) {
    SortUnrolled<kRows>(value, weight, kSteps);
  } else {
    SortValuesUnrolled<kRows>(value, kSteps);
  }
}

HWY_INLINE void SortMany(std::size_t n, float* value, float* weight) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  for (const Exchange& step : reduce::Network(n)) {
    float* const value_low = value + step.low * lanes;
    float* const value_high = value + step.high * lanes;
    V va = hn::Load(d, value_low), vb = hn::Load(d, value_high);
    if (weight != nullptr) {
      float* const weight_low = weight + step.low * lanes;
      float* const weight_high = weight + step.high * lanes;
      V wa = hn::Load(d, weight_low), wb = hn::Load(d, weight_high);
      OrderPair(va, wa, vb, wb);
      hn::Store(wa, d, weight_low);
      hn::Store(wb, d, weight_high);
    } else {
      const V low = hn::Min(va, vb);
      vb = hn::Max(va, vb);
      va = low;
    }
    hn::Store(va, d, value_low);
    hn::Store(vb, d, value_high);
  }
}

// Sorts `n` rows lane by lane: by (value, weight), or by value alone when `weight` is null.
HWY_INLINE void Sort(std::size_t n, float* value, float* weight) {
  switch (n) {
    case 0:
    case 1:
      return;
    case 2:
      return SortFew<2>(value, weight);
    case 3:
      return SortFew<3>(value, weight);
    case 4:
      return SortFew<4>(value, weight);
    case 5:
      return SortFew<5>(value, weight);
    case 6:
      return SortFew<6>(value, weight);
    case 7:
      return SortFew<7>(value, weight);
    case 8:
      return SortFew<8>(value, weight);
    default:
      return SortMany(n, value, weight);
  }
}

HWY_INLINE V Total(std::size_t n, const float* weight) {
  const D d;
  V total = hn::Zero(d);
  for (std::size_t i = 0; i < n; ++i) total = hn::Add(total, hn::Load(d, weight + i * hn::Lanes(d)));
  return total;
}

// The same operations in the same order as BlendedMedian in median.cc.
HWY_INLINE V BlendedMedianOf(std::size_t n, const float* value, const float* weight, float blend) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const V zero = hn::Zero(d);
  const V total = Total(n, weight);
  const V low = hn::Mul(hn::Set(d, 0.5f - blend), total);
  const V high = hn::Mul(hn::Set(d, 0.5f + blend), total);
  V below = zero, sum = zero, base = zero;
  auto started = hn::Lt(zero, zero);
  for (std::size_t i = 0; i < n; ++i) {
    const V v = hn::Load(d, value + i * lanes);
    const V above = hn::Add(below, hn::Load(d, weight + i * lanes));
    const V part = hn::Sub(hn::Min(above, high), hn::Max(below, low));
    const auto takes_part = hn::Gt(part, zero);
    base = hn::IfThenElse(hn::AndNot(started, takes_part), v, base);
    started = hn::Or(started, takes_part);
    sum = hn::IfThenElse(takes_part, hn::Add(sum, hn::Mul(part, hn::Sub(v, base))), sum);
    below = above;
  }
  return hn::Add(base, hn::Div(sum, hn::Sub(high, low)));
}

// As StrictMedian in median.cc.
HWY_INLINE V StrictMedianOf(std::size_t n, const float* value, const float* weight) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const V zero = hn::Zero(d);
  const V half = hn::Mul(hn::Set(d, 0.5f), Total(n, weight));
  V below = zero, lower = zero, upper = zero;
  auto has_lower = hn::Lt(zero, zero);
  auto has_upper = has_lower;
  for (std::size_t i = 0; i < n; ++i) {
    const V v = hn::Load(d, value + i * lanes);
    below = hn::Add(below, hn::Load(d, weight + i * lanes));
    const auto reaches = hn::Ge(below, half);
    const auto exceeds = hn::Gt(below, half);
    lower = hn::IfThenElse(hn::AndNot(has_lower, reaches), v, lower);
    upper = hn::IfThenElse(hn::AndNot(has_upper, exceeds), v, upper);
    has_lower = hn::Or(has_lower, reaches);
    has_upper = hn::Or(has_upper, exceeds);
  }
  return hn::Mul(hn::Set(d, 0.5f), hn::Add(lower, upper));
}

HWY_INLINE V WeightedMedianOf(std::size_t n, const float* value, const float* weight, double blend) {
  return blend == 0.0 ? StrictMedianOf(n, value, weight) : BlendedMedianOf(n, value, weight, static_cast<float>(blend));
}

// Median of the first `count` of `n` sorted values, lane by lane: the mean of the two in the middle.
HWY_INLINE V PlainMedianOf(std::size_t n, const float* value, V count) {
  const D d;
  const V half = hn::Mul(hn::Set(d, 0.5f), count);
  const V upper_index = hn::Floor(half);
  const V lower_index = hn::Sub(hn::Ceil(half), hn::Set(d, 1.0f));
  V lower = hn::Zero(d), upper = hn::Zero(d);
  for (std::size_t i = 0; i < n; ++i) {
    const V v = hn::Load(d, value + i * hn::Lanes(d));
    const V index = hn::Set(d, static_cast<float>(i));
    lower = hn::IfThenElse(hn::Eq(index, lower_index), v, lower);
    upper = hn::IfThenElse(hn::Eq(index, upper_index), v, upper);
  }
  return hn::Mul(hn::Set(d, 0.5f), hn::Add(lower, upper));
}

// As BiweightStep in median.cc. Absent samples have weight 0 and a trust that is clamped to 0.
HWY_INLINE V BiweightOf(std::size_t n, const float* value, const float* weight, V median, V mad, float floor) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const V zero = hn::Zero(d), one = hn::Set(d, 1.0f);
  const V wanted = hn::Add(hn::Mul(hn::Set(d, kBiweightCutoff), mad), hn::Set(d, floor));
  const auto spreads = hn::Gt(wanted, zero);
  const V scale = hn::IfThenElse(spreads, wanted, one);
  V sum = zero, total = zero;
  for (std::size_t i = 0; i < n; ++i) {
    const V w = hn::Load(d, weight + i * lanes);
    // An absent value would overflow.
    const V deviation = hn::IfThenElseZero(hn::Gt(w, zero), hn::Sub(hn::Load(d, value + i * lanes), median));
    const V u = hn::Div(deviation, scale);
    const V trust = hn::Max(hn::Sub(one, hn::Mul(u, u)), zero);
    const V share = hn::Mul(w, hn::Mul(trust, trust));
    sum = hn::Add(sum, hn::Mul(share, deviation));
    total = hn::Add(total, share);
  }
  const auto moves = hn::And(spreads, hn::Gt(total, zero));
  return hn::IfThenElse(moves, hn::Add(median, hn::Div(sum, hn::IfThenElse(moves, total, one))), median);
}

// Columns [x, x + lanes) of `plane`, whose element 0 is column row.begin; 0 outside of the row.
HWY_INLINE V LoadColumns(const SampleRow& row, const float* plane, int x, int lanes) {
  const D d;
  if (x >= row.begin && x + lanes <= row.end) return hn::LoadU(d, plane + (x - row.begin));
  HWY_ALIGN float part[reduce::kLanesMax] = {};
  const int first = std::max(x, row.begin), last = std::min(x + lanes, row.end);
  for (int column = first; column < last; ++column) part[column - x] = plane[column - row.begin];
  return hn::Load(d, part);
}

HWY_INLINE void StoreColumns(V v, float* plane, int x, int count) {
  const D d;
  const int left = count - x;
  if (left >= static_cast<int>(hn::Lanes(d))) return hn::StoreU(v, d, plane + x);
  HWY_ALIGN float part[reduce::kLanesMax];
  hn::Store(v, d, part);
  std::copy_n(part, left, plane + x);
}

HWY_INLINE void ReduceBlock(const SampleRow* const* rows, std::size_t row_count, int x, int count, const ReduceOptions& options,
                            const ReducedRow& out, Block* block) {
  const D d;
  const std::size_t lanes = hn::Lanes(d);
  const int width = static_cast<int>(lanes);
  const V zero = hn::Zero(d), one = hn::Set(d, 1.0f), half = hn::Set(d, 0.5f), absent = hn::Set(d, kAbsent);
  V best = zero;
  for (std::size_t k = 0; k < row_count; ++k) {
    const V w = LoadColumns(*rows[k], rows[k]->weight, x, width);
    const V s = LoadColumns(*rows[k], rows[k]->saturation, x, width);
    hn::Store(s, d, block->deviation + k * lanes);
    hn::Store(w, d, block->deviation_weight + k * lanes);
    best = hn::Max(best, hn::IfThenElseZero(hn::Gt(w, zero), s));
  }
  const V limit = hn::Min(half, hn::Mul(hn::Set(d, options.poor_ratio), best));
  const bool one_vote = options.median.estimator == Estimator::kMedian;
  V samples = zero, weight_sum = zero, sigma2_sum = zero, heaviest = zero;
  V source = hn::Set(d, options.no_source);
  std::size_t n = 0;
  for (std::size_t k = 0; k < row_count; ++k) {
    const V given = hn::Load(d, block->deviation_weight + k * lanes);
    const auto takes_part = hn::And(hn::Gt(given, zero), hn::Ge(hn::Load(d, block->deviation + k * lanes), limit));
    if (hn::AllFalse(d, takes_part)) continue;
    const V w = hn::IfThenElseZero(takes_part, given);
    hn::Store(hn::IfThenElse(takes_part, LoadColumns(*rows[k], rows[k]->value, x, width), absent), d, block->value + n * lanes);
    hn::Store(one_vote ? hn::IfThenElseZero(takes_part, one) : w, d, block->weight + n * lanes);
    samples = hn::Add(samples, hn::IfThenElseZero(takes_part, one));
    weight_sum = hn::Add(weight_sum, w);
    sigma2_sum = hn::Add(sigma2_sum, hn::Mul(w, hn::Set(d, rows[k]->sigma2)));
    const auto dominates = hn::Gt(w, heaviest);
    heaviest = hn::Max(heaviest, w);
    source = hn::IfThenElse(dominates, hn::Set(d, rows[k]->source), source);
    ++n;
  }
  const auto covered = hn::Gt(samples, zero);
  const V nan = hn::Set(d, std::numeric_limits<float>::quiet_NaN());
  const V divisor = hn::IfThenElse(covered, weight_sum, one);
  StoreColumns(samples, out.count, x, count);
  StoreColumns(source, out.source, x, count);
  StoreColumns(hn::IfThenElse(covered, hn::Sqrt(hn::Div(sigma2_sum, divisor)), nan), out.position_sigma, x, count);

  const double blend = options.median.blend;
  float* const sorted_weight = one_vote ? nullptr : block->weight;
  Sort(n, block->value, sorted_weight);
  V result = one_vote ? PlainMedianOf(n, block->value, samples) : WeightedMedianOf(n, block->value, block->weight, blend);
  V mad = zero;
  if (n > 1) {
    for (std::size_t i = 0; i < n; ++i) {
      const V v = hn::Load(d, block->value + i * lanes);
      const V deviation = hn::IfThenElse(hn::Eq(v, absent), absent, hn::Abs(hn::Sub(v, result)));
      hn::Store(deviation, d, block->deviation + i * lanes);
      if (!one_vote) hn::Store(hn::Load(d, block->weight + i * lanes), d, block->deviation_weight + i * lanes);
    }
    Sort(n, block->deviation, one_vote ? nullptr : block->deviation_weight);
    mad = one_vote ? PlainMedianOf(n, block->deviation, samples) : WeightedMedianOf(n, block->deviation, block->deviation_weight, blend);
    if (options.median.estimator == Estimator::kBiweight) {
      result = BiweightOf(n, block->value, block->weight, result, mad, static_cast<float>(options.median.biweight_floor));
    }
  }
  StoreColumns(hn::IfThenElse(covered, result, nan), out.value, x, count);
  const V nmad = hn::Mul(hn::Set(d, static_cast<float>(kNmadPerMad)), mad);
  StoreColumns(hn::IfThenElse(hn::Gt(samples, one), nmad, nan), out.nmad, x, count);
}

// Columns [x, end) of more rows than a network takes.
void ReducePixelByPixel(const SampleRow* const* rows, std::size_t row_count, int x, int end, const ReduceOptions& options,
                        const ReducedRow& out) {
  std::vector<WeightedSample> samples;
  for (; x < end; ++x) {
    float best = 0.0f;
    for (std::size_t k = 0; k < row_count; ++k) {
      const SampleRow& row = *rows[k];
      if (x >= row.begin && x < row.end && row.weight[x - row.begin] > 0.0f) best = std::max(best, row.saturation[x - row.begin]);
    }
    const float limit = std::min(0.5f, options.poor_ratio * best);
    samples.clear();
    float weight_sum = 0.0f, sigma2_sum = 0.0f;
    for (std::size_t k = 0; k < row_count; ++k) {
      const SampleRow& row = *rows[k];
      if (x < row.begin || x >= row.end) continue;
      const int i = x - row.begin;
      if (!(row.weight[i] > 0.0f) || !(row.saturation[i] >= limit)) continue;
      samples.push_back({row.value[i], row.weight[i], static_cast<std::uint32_t>(k)});
      weight_sum += row.weight[i];
      sigma2_sum += row.weight[i] * row.sigma2;
    }
    constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
    out.count[x] = static_cast<float>(samples.size());
    out.source[x] = options.no_source;
    out.value[x] = out.nmad[x] = out.position_sigma[x] = kNan;
    if (samples.empty()) continue;
    const PixelMedian pixel = ReducePixel(samples, options.median);
    out.value[x] = pixel.median;
    if (pixel.count > 1) out.nmad[x] = pixel.nmad;
    out.position_sigma[x] = std::sqrt(sigma2_sum / weight_sum);
    out.source[x] = rows[pixel.source]->source;
  }
}

void ReduceRowTarget(const SampleRow* const* all, std::size_t row_count, int count, const ReduceOptions& options, const ReducedRow& out,
                     const SampleRow** near_rows) {
  const int lanes = static_cast<int>(hn::Lanes(D()));
  Block block;
  std::size_t near = 0;
  int next_begin = 0, next_end = 0;  // Until there the rows that are near stay the same.
  for (int x = 0; x < count; x += lanes) {
    const int end = std::min(x + lanes, count);
    if (end > next_begin || x >= next_end) {
      near = 0;
      next_begin = next_end = std::numeric_limits<int>::max();
      for (std::size_t k = 0; k < row_count; ++k) {
        if (all[k]->begin >= end) next_begin = std::min(next_begin, all[k]->begin);
        if (all[k]->begin >= end || all[k]->end <= x) continue;
        near_rows[near++] = all[k];
        next_end = std::min(next_end, all[k]->end);
      }
    }
    if (near > static_cast<std::size_t>(kNetworkRowsMax)) {
      ReducePixelByPixel(near_rows, near, x, end, options, out);
    } else {
      ReduceBlock(near_rows, near, x, count, options, out, &block);
    }
  }
}

}  // namespace trem::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace trem {

HWY_EXPORT(ReduceRowTarget);

void ReduceRow(std::span<const SampleRow> rows, int count, const ReduceOptions& options, const ReducedRow& out) {
  std::vector<const SampleRow*> all, near_rows(rows.size());
  all.reserve(rows.size());
  for (const SampleRow& row : rows) all.push_back(&row);
  HWY_DYNAMIC_DISPATCH(ReduceRowTarget)(all.data(), all.size(), count, options, out, near_rows.data());
}

}  // namespace trem
#endif  // HWY_ONCE
