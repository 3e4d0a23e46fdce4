#include "mosaic/composite/reduce_row.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "mosaic/base/check.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "mosaic/composite/reduce_row.cc"
#include <hwy/foreach_target.h>
// After foreach_target.h, which includes this file again for every target.
#include <hwy/aligned_allocator.h>
#include <hwy/cache_control.h>
#include <hwy/highway.h>

#ifndef TREM_MOSAIC_COMPOSITE_REDUCE_ROW_ONCE
#define TREM_MOSAIC_COMPOSITE_REDUCE_ROW_ONCE
namespace trem::reduce {

// Sorts after every sample.
inline constexpr float kAbsent = std::numeric_limits<float>::max();
inline constexpr std::size_t kFewMax = 8;     // Rows that are kept in registers.
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

// All pairs i < j of kRows rows, i ascending, then j.
template <std::size_t kRows>
constexpr auto PairsOf() {
  std::array<Exchange, kRows*(kRows - 1) / 2> pairs{};
  std::size_t at = 0;
  for (std::size_t i = 0; i < kRows; ++i) {
    for (std::size_t j = i + 1; j < kRows; ++j) pairs[at++] = {static_cast<std::uint8_t>(i), static_cast<std::uint8_t>(j)};
  }
  return pairs;
}

}  // namespace trem::reduce
#endif  // TREM_MOSAIC_COMPOSITE_REDUCE_ROW_ONCE

HWY_BEFORE_NAMESPACE();
namespace trem::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::ScalableTag<float>;
using V = hn::Vec<D>;
using reduce::kAbsent;

// Samples of a block of pixels, one vector a row.
struct Block {
  V* value;
  V* weight;  // 0: the sample does not take part.
  V* deviation;
  V* below;
};

HWY_INLINE void OrderValues(V& a, V& b) {
  const V low = hn::Min(a, b);
  b = hn::Max(a, b);
  a = low;
}

template <std::size_t kRows, std::size_t... kSteps>
HWY_INLINE void SortValues([[maybe_unused]] V* value, std::index_sequence<kSteps...>) {
  [[maybe_unused]] constexpr auto kNetwork = reduce::NetworkOf<kRows>();
  (OrderValues(value[kNetwork[kSteps].low], value[kNetwork[kSteps].high]), ...);
}

// `sum` and what weighs `weight`, in the lanes of `mask`.
template <typename M>
HWY_INLINE V AddIf(M mask, V sum, V weight) {
  return hn::IfThenElse(mask, hn::Add(sum, weight), sum);
}

// Of rows i < j: adds each one's weight to what lies below the other.
HWY_INLINE void WeighPair(V vi, V wi, V& below_i, V vj, V wj, V& below_j) {
  const auto in_order = hn::Le(vi, vj);
  below_j = AddIf(in_order, below_j, wi);
  below_i = AddIf(hn::Not(in_order), below_i, wj);
}

template <std::size_t kRows, std::size_t... kPairs>
HWY_INLINE void WeighPairs([[maybe_unused]] const V* value, [[maybe_unused]] const V* weight, V* below, std::index_sequence<kPairs...>) {
  [[maybe_unused]] constexpr auto kPair = reduce::PairsOf<kRows>();
  const V zero = hn::Zero(D());
  _Pragma("GCC unroll 8") for (std::size_t i = 0; i < kRows; ++i) below[i] = zero;
  (WeighPair(value[kPair[kPairs].low], weight[kPair[kPairs].low], below[kPair[kPairs].low], value[kPair[kPairs].high],
             weight[kPair[kPairs].high], below[kPair[kPairs].high]),
   ...);
}

// Rows [first, first + kStep) of WeightBelow, kStep at a time so that their sums do not wait for each other.
template <std::size_t kStep>
HWY_INLINE void WeighRows(std::size_t n, std::size_t first, const V* value, const V* weight, V* below) {
  const V zero = hn::Zero(D());
  V own[kStep], sum[kStep];
  _Pragma("GCC unroll 4") for (std::size_t a = 0; a < kStep; ++a) own[a] = value[first + a];
  _Pragma("GCC unroll 4") for (std::size_t a = 0; a < kStep; ++a) sum[a] = zero;
  for (std::size_t j = 0; j < first; ++j) {
    _Pragma("GCC unroll 4") for (std::size_t a = 0; a < kStep; ++a) sum[a] = AddIf(hn::Le(value[j], own[a]), sum[a], weight[j]);
  }
  _Pragma("GCC unroll 4") for (std::size_t b = 0; b < kStep; ++b) {
    _Pragma("GCC unroll 4") for (std::size_t a = 0; a < kStep; ++a) {
      if (b == a) continue;
      const auto before = b < a ? hn::Le(own[b], own[a]) : hn::Lt(own[b], own[a]);
      sum[a] = AddIf(before, sum[a], weight[first + b]);
    }
  }
  for (std::size_t j = first + kStep; j < n; ++j) {
    _Pragma("GCC unroll 4") for (std::size_t a = 0; a < kStep; ++a) sum[a] = AddIf(hn::Lt(value[j], own[a]), sum[a], weight[j]);
  }
  _Pragma("GCC unroll 4") for (std::size_t a = 0; a < kStep; ++a) below[first + a] = sum[a];
}

// below[i]: the weight of the samples that come before sample i in the order (value, row), summed by rows. Nothing is sorted: a handful of
// comparisons that do not wait for each other is faster than a network of exchanges that do.
template <std::size_t kRows>
HWY_INLINE void WeighBelow(std::size_t n, const V* value, const V* weight, V* below) {
  if constexpr (kRows > 0) {
    WeighPairs<kRows>(value, weight, below, std::make_index_sequence<kRows*(kRows - 1) / 2>());
  } else {
    constexpr std::size_t kStep = 4;
    std::size_t i = 0;
    for (; i + kStep <= n; i += kStep) WeighRows<kStep>(n, i, value, weight, below);
    for (; i < n; ++i) WeighRows<1>(n, i, value, weight, below);
  }
}

HWY_INLINE V Total(std::size_t n, const V* weight) {
  V total = weight[0];
  _Pragma("GCC unroll 8") for (std::size_t i = 1; i < n; ++i) total = hn::Add(total, weight[i]);
  return total;
}

// The bytes of BlendedMedian in median.cc. A sample that does not take part has no part of the weight and adds exactly nothing.
HWY_INLINE V BlendedMedianOf(std::size_t n, const V* value, const V* weight, const V* below, float blend) {
  const D d;
  const V zero = hn::Zero(d);
  const V total = Total(n, weight);
  const V low = hn::Mul(hn::Set(d, 0.5f - blend), total);
  const V high = hn::Mul(hn::Set(d, 0.5f + blend), total);
  const auto part = [&](std::size_t i) HWY_ATTR {
    const V above = hn::Add(below[i], weight[i]);
    return hn::Sub(hn::Min(hn::Max(above, low), high), hn::Min(hn::Max(below[i], low), high));
  };
  V base = zero, sum = zero;
  _Pragma("GCC unroll 8") for (std::size_t i = 0; i < n; ++i) base = hn::IfThenElse(hn::Gt(part(i), zero), value[i], base);
  _Pragma("GCC unroll 8") for (std::size_t i = 0; i < n; ++i) sum = hn::Add(sum, hn::Mul(part(i), hn::Sub(value[i], base)));
  return hn::Add(base, hn::Div(sum, hn::Sub(high, low)));
}

// As StrictMedian in median.cc.
HWY_INLINE V StrictMedianOf(std::size_t n, const V* value, const V* weight, const V* below) {
  const D d;
  const V half = hn::Mul(hn::Set(d, 0.5f), Total(n, weight));
  V lower = hn::Set(d, kAbsent), upper = lower;
  _Pragma("GCC unroll 8") for (std::size_t i = 0; i < n; ++i) {
    const auto given = hn::Gt(weight[i], hn::Zero(d));
    const V above = hn::Add(below[i], weight[i]);
    lower = hn::IfThenElse(hn::And(given, hn::Ge(above, half)), hn::Min(lower, value[i]), lower);
    upper = hn::IfThenElse(hn::And(given, hn::Gt(above, half)), hn::Min(upper, value[i]), upper);
  }
  return hn::Mul(hn::Set(d, 0.5f), hn::Add(lower, upper));
}

template <std::size_t kRows>
HWY_INLINE V WeightedMedianOf(std::size_t n, const V* value, const V* weight, V* below, double blend) {
  WeighBelow<kRows>(n, value, weight, below);
  return blend == 0.0 ? StrictMedianOf(n, value, weight, below) : BlendedMedianOf(n, value, weight, below, static_cast<float>(blend));
}

// Median of the first `count` of `n` sorted values, lane by lane: the mean of the two in the middle.
HWY_INLINE V PlainMedianOf(std::size_t n, const V* value, V count) {
  const D d;
  const V half = hn::Mul(hn::Set(d, 0.5f), count);
  const V upper_index = hn::Floor(half);
  const V lower_index = hn::Sub(hn::Ceil(half), hn::Set(d, 1.0f));
  V lower = hn::Zero(d), upper = hn::Zero(d);
  // n >= 1, so n / 2 is one of them.
  _Pragma("GCC unroll 8") for (std::size_t i = 0; i <= n / 2; ++i) {
    const V index = hn::Set(d, static_cast<float>(i));
    lower = hn::IfThenElse(hn::Eq(index, lower_index), value[i], lower);
    upper = hn::IfThenElse(hn::Eq(index, upper_index), value[i], upper);
  }
  return hn::Mul(hn::Set(d, 0.5f), hn::Add(lower, upper));
}

// As BiweightStep in median.cc.
HWY_INLINE V BiweightOf(std::size_t n, const V* value, const V* weight, V median, V mad, float floor) {
  const D d;
  const V zero = hn::Zero(d), one = hn::Set(d, 1.0f);
  const V wanted = hn::Add(hn::Mul(hn::Set(d, kBiweightCutoff), mad), hn::Set(d, floor));
  const auto spreads = hn::Gt(wanted, zero);
  const V scale = hn::IfThenElse(spreads, wanted, one);
  V sum = zero, total = zero;
  _Pragma("GCC unroll 8") for (std::size_t i = 0; i < n; ++i) {
    const V deviation = hn::Sub(value[i], median);
    const V u = hn::Div(deviation, scale);
    const V trust = hn::Max(hn::Sub(one, hn::Mul(u, u)), zero);
    const V share = hn::Mul(weight[i], hn::Mul(trust, trust));
    sum = hn::Add(sum, hn::Mul(share, deviation));
    total = hn::Add(total, share);
  }
  const auto moves = hn::And(spreads, hn::Gt(total, zero));
  return hn::IfThenElse(moves, hn::Add(median, hn::Div(sum, hn::IfThenElse(moves, total, one))), median);
}

// More rows are read side by side than the processor's own prefetching follows; floats ahead of the ones that are read.
constexpr int kAhead = 128;

// Columns [x, x + lanes) of `plane`, whose element 0 is column row.begin; 0 outside of the row.
HWY_INLINE V LoadColumns(const SampleRow& row, const float* plane, int x, int lanes) {
  const D d;
  if (x >= row.begin && x + lanes <= row.end) {
    const float* const at = plane + (x - row.begin);
    hwy::Prefetch(at + kAhead);
    return hn::LoadU(d, at);
  }
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

// Samples of the rows that are near, with weight 0 where a lane's does not take part; what follows from them without order goes out.
// Returns their number, lane by lane. `n` > 0.
HWY_INLINE V GatherSamples(const SampleRow* const* rows, std::size_t n, int x, int count, const ReduceOptions& options,
                           const ReducedRow& out, const Block& block) {
  const D d;
  const int width = static_cast<int>(hn::Lanes(d));
  const V zero = hn::Zero(d), one = hn::Set(d, 1.0f);
  V best = zero;
  _Pragma("GCC unroll 8") for (std::size_t k = 0; k < n; ++k) {
    block.weight[k] = LoadColumns(*rows[k], rows[k]->weight, x, width);
    block.deviation[k] = LoadColumns(*rows[k], rows[k]->saturation, x, width);
    best = hn::Max(best, hn::IfThenElseZero(hn::Gt(block.weight[k], zero), block.deviation[k]));
  }
  const V limit = hn::Min(hn::Set(d, 0.5f), hn::Mul(hn::Set(d, options.poor_ratio), best));
  V samples = zero, weight_sum = zero, sigma2_sum = zero, heaviest = zero;
  V source = hn::Set(d, options.no_source);
  _Pragma("GCC unroll 8") for (std::size_t k = 0; k < n; ++k) {
    const auto takes_part = hn::And(hn::Gt(block.weight[k], zero), hn::Ge(block.deviation[k], limit));
    const V w = hn::IfThenElseZero(takes_part, block.weight[k]);
    block.value[k] = LoadColumns(*rows[k], rows[k]->value, x, width);
    block.weight[k] = w;
    samples = AddIf(takes_part, samples, one);
    weight_sum = hn::Add(weight_sum, w);
    sigma2_sum = hn::Add(sigma2_sum, hn::Mul(w, hn::Set(d, rows[k]->sigma2)));
    const auto dominates = hn::Gt(w, heaviest);
    heaviest = hn::Max(heaviest, w);
    source = hn::IfThenElse(dominates, hn::Set(d, rows[k]->source), source);
  }
  const auto covered = hn::Gt(samples, zero);
  const V divisor = hn::IfThenElse(covered, weight_sum, one);
  StoreColumns(samples, out.count, x, count);
  StoreColumns(source, out.source, x, count);
  const V nan = hn::Set(d, std::numeric_limits<float>::quiet_NaN());
  StoreColumns(hn::IfThenElse(covered, hn::Sqrt(hn::Div(sigma2_sum, divisor)), nan), out.position_sigma, x, count);
  return samples;
}

struct Centre {
  V value;
  V mad;
};

// Every sample one vote: few rows are sorted by a network, by value alone.
template <std::size_t kRows>
HWY_INLINE Centre PlainCentre(const Block& block, V samples) {
  const D d;
  const V absent = hn::Set(d, kAbsent);
  constexpr auto kSteps = std::make_index_sequence<reduce::ExchangeCount(kRows)>();
  _Pragma("GCC unroll 8") for (std::size_t i = 0; i < kRows; ++i) {
    block.value[i] = hn::IfThenElse(hn::Gt(block.weight[i], hn::Zero(d)), block.value[i], absent);
  }
  SortValues<kRows>(block.value, kSteps);
  const V median = PlainMedianOf(kRows, block.value, samples);
  _Pragma("GCC unroll 8") for (std::size_t i = 0; i < kRows; ++i) {
    block.deviation[i] = hn::IfThenElse(hn::Eq(block.value[i], absent), absent, hn::Abs(hn::Sub(block.value[i], median)));
  }
  SortValues<kRows>(block.deviation, kSteps);
  return {median, PlainMedianOf(kRows, block.deviation, samples)};
}

template <std::size_t kRows>
HWY_INLINE Centre WeightedCentre(std::size_t n, const Block& block, const MedianOptions& options) {
  const bool one_vote = options.estimator == Estimator::kMedian;
  const D d;
  if (one_vote) {
    for (std::size_t i = 0; i < n; ++i) {
      block.weight[i] = hn::IfThenElseZero(hn::Gt(block.weight[i], hn::Zero(d)), hn::Set(d, 1.0f));
    }
  }
  const double blend = one_vote ? 0.0 : options.blend;
  const V median = WeightedMedianOf<kRows>(n, block.value, block.weight, block.below, blend);
  if (n == 1) return {median, hn::Zero(d)};
  _Pragma("GCC unroll 8") for (std::size_t i = 0; i < n; ++i) block.deviation[i] = hn::Abs(hn::Sub(block.value[i], median));
  const V mad = WeightedMedianOf<kRows>(n, block.deviation, block.weight, block.below, blend);
  if (options.estimator != Estimator::kBiweight) return {median, mad};
  return {BiweightOf(n, block.value, block.weight, median, mad, static_cast<float>(options.biweight_floor)), mad};
}

// kRows > 0: that many rows, known to the compiler, which then keeps them in registers; 0: any number.
template <std::size_t kRows>
HWY_INLINE void ReduceBlock(const SampleRow* const* rows, std::size_t n, int x, int count, const ReduceOptions& options,
                            const ReducedRow& out, const Block& block) {
  const D d;
  const V samples = GatherSamples(rows, n, x, count, options, out, block);
  Centre centre;
  if constexpr (kRows > 0) {
    centre = options.median.estimator == Estimator::kMedian ? PlainCentre<kRows>(block, samples)
                                                            : WeightedCentre<kRows>(n, block, options.median);
  } else {
    centre = WeightedCentre<0>(n, block, options.median);
  }
  const V nan = hn::Set(d, std::numeric_limits<float>::quiet_NaN());
  StoreColumns(hn::IfThenElse(hn::Gt(samples, hn::Zero(d)), centre.value, nan), out.value, x, count);
  const V nmad = hn::Mul(hn::Set(d, static_cast<float>(kNmadPerMad)), centre.mad);
  StoreColumns(hn::IfThenElse(hn::Gt(samples, hn::Set(d, 1.0f)), nmad, nan), out.nmad, x, count);
}

template <std::size_t kRows>
HWY_NOINLINE void ReduceFew(const SampleRow* const* rows, int x, int count, const ReduceOptions& options, const ReducedRow& out) {
  V value[kRows], weight[kRows], deviation[kRows], below[kRows];
  ReduceBlock<kRows>(rows, kRows, x, count, options, out, {value, weight, deviation, below});
}

// `scratch` holds 4 n vectors.
HWY_NOINLINE void ReduceMany(const SampleRow* const* rows, std::size_t n, int x, int count, const ReduceOptions& options,
                             const ReducedRow& out, V* scratch) {
  ReduceBlock<0>(rows, n, x, count, options, out, {scratch, scratch + n, scratch + 2 * n, scratch + 3 * n});
}

HWY_NOINLINE void ReduceNone(int x, int count, const ReduceOptions& options, const ReducedRow& out) {
  const D d;
  const V nan = hn::Set(d, std::numeric_limits<float>::quiet_NaN());
  StoreColumns(hn::Zero(d), out.count, x, count);
  StoreColumns(hn::Set(d, options.no_source), out.source, x, count);
  for (float* const plane : {out.value, out.nmad, out.position_sigma}) StoreColumns(nan, plane, x, count);
}

using FewFunction = void (*)(const SampleRow* const*, int, int, const ReduceOptions&, const ReducedRow&);

// ReduceFew of 1, 2, ... rows.
template <std::size_t... kRowsLess1>
constexpr auto FewFunctions(std::index_sequence<kRowsLess1...>) {
  return std::array<FewFunction, sizeof...(kRowsLess1)>{ReduceFew<kRowsLess1 + 1>...};
}

void ReduceNear(const SampleRow* const* rows, std::size_t n, int x, int count, const ReduceOptions& options, const ReducedRow& out,
                V* scratch) {
  static constexpr auto kFew = FewFunctions(std::make_index_sequence<reduce::kFewMax>());
  if (n == 0) return ReduceNone(x, count, options, out);
  if (n <= kFew.size()) return kFew[n - 1](rows, x, count, options, out);
  ReduceMany(rows, n, x, count, options, out, scratch);
}

void ReduceRowTarget(const SampleRow* const* all, std::size_t row_count, int count, const ReduceOptions& options, const ReducedRow& out,
                     const SampleRow** near_rows) {
  const int lanes = static_cast<int>(hn::Lanes(D()));
  const auto scratch = hwy::AllocateAligned<V>(4 * std::max<std::size_t>(row_count, 1));
  TREM_CHECK(scratch != nullptr);
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
    ReduceNear(near_rows, near, x, count, options, out, scratch.get());
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
