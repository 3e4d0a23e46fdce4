#include "worker/sensor/filter_rows.h"

#include <algorithm>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "worker/sensor/filter_rows.cc"
#include <hwy/foreach_target.h>
// After foreach_target.h, which includes this file again for every target.
#include "worker/sensor/filter_rows-inl.h"

HWY_BEFORE_NAMESPACE();
namespace trem::HWY_NAMESPACE {

// Columns [begin, end) of kRows rows. kRadius 0: any radius.
template <int kRows, int kRadius>
HWY_INLINE void FilterColumnsBetween(const float* const* rows, const float* HWY_RESTRICT taps, int radius, std::size_t begin,
                                     std::size_t end, float* HWY_RESTRICT out, std::ptrdiff_t stride) {
  const hn::ScalableTag<float> d;
  using V = hn::Vec<decltype(d)>;
  const Taps<kRadius, hn::ScalableTag<float>> known(d, taps);
  const std::size_t lanes = hn::Lanes(d);
  std::size_t x = begin;
  for (; x + lanes <= end; x += lanes) {
    FilterColumnsAt<kRows, kRadius>(
        d, rows, known, taps, radius, static_cast<std::ptrdiff_t>(x), [d](const float* p) HWY_ATTR { return hn::LoadU(d, p); },
        [&](int i, V v) HWY_ATTR { hn::StoreU(v, d, out + i * stride + static_cast<std::ptrdiff_t>(x)); });
  }
  if (x == end) return;
  FilterColumnsAt<kRows, kRadius>(
      d, rows, known, taps, radius, static_cast<std::ptrdiff_t>(x), [&](const float* p) HWY_ATTR { return LoadUpTo(d, p, end - x); },
      [&](int i, V v) HWY_ATTR { StoreUpTo(d, v, out + i * stride + static_cast<std::ptrdiff_t>(x), end - x); });
}

void FilterColumnBlockTarget(const float* const* rows, const float* taps, int radius, int row_count, int count, float* out,
                             std::ptrdiff_t stride) {
  // What the rows of the block share of such a chunk stays in the first-level cache.
  constexpr std::size_t kChunk = 256;
  const std::size_t end = static_cast<std::size_t>(count);
  WithRadius(radius, [&](auto known) HWY_ATTR {
    constexpr int kRadius = decltype(known)::value;
    for (std::size_t x = 0; x < end; x += kChunk) {
      const std::size_t chunk_end = std::min(x + kChunk, end);
      int i = 0;
      for (; i + kRowsTogether <= row_count; i += kRowsTogether) {
        FilterColumnsBetween<kRowsTogether, kRadius>(rows + i, taps, radius, x, chunk_end, out + i * stride, stride);
      }
      for (; i < row_count; ++i) FilterColumnsBetween<1, kRadius>(rows + i, taps, radius, x, chunk_end, out + i * stride, stride);
    }
  });
}

void FilterRowsTarget(const FilterBlock& block, float* const* out) {
  const hn::ScalableTag<float> d;
  using V = hn::Vec<decltype(d)>;
  FilterBlockInto(d, block, [&](int i) HWY_ATTR {
    return [d, to = out[i], end = block.end](int x, V sum) HWY_ATTR { StoreUpTo(d, sum, to + x, static_cast<std::size_t>(end - x)); };
  });
}

}  // namespace trem::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace trem {

HWY_EXPORT(FilterColumnBlockTarget);
HWY_EXPORT(FilterRowsTarget);

void FilterColumns(const float* const* rows, const float* taps, int radius, int count, float* out) {
  FilterColumnBlock(rows, taps, radius, 1, count, out, 0);
}

void FilterColumnBlock(const float* const* rows, const float* taps, int radius, int row_count, int count, float* out,
                       std::ptrdiff_t stride) {
  HWY_DYNAMIC_DISPATCH(FilterColumnBlockTarget)(rows, taps, radius, row_count, count, out, stride);
}

void FilterRows(const FilterBlock& block, float* const* out) { HWY_DYNAMIC_DISPATCH(FilterRowsTarget)(block, out); }

}  // namespace trem
#endif  // HWY_ONCE
