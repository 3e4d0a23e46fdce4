#include "worker/sensor/filter_rows.h"

#include <algorithm>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "worker/sensor/filter_rows.cc"
#include <hwy/foreach_target.h>
// After foreach_target.h, which includes this file again for every target.
#include "worker/sensor/filter_rows-inl.h"

HWY_BEFORE_NAMESPACE();
namespace trem::HWY_NAMESPACE {

// Columns [begin, end) of one row.
HWY_INLINE void FilterColumnsBetween(const float* const* rows, const float* HWY_RESTRICT taps, int radius, std::size_t begin,
                                     std::size_t end, float* HWY_RESTRICT out) {
  const hn::ScalableTag<float> d;
  const std::size_t lanes = hn::Lanes(d);
  const float* middle = rows[radius];
  std::size_t x = begin;
  for (; x + 4 * lanes <= end; x += 4 * lanes) {
    const auto centre = hn::Set(d, taps[0]);
    auto s0 = hn::Mul(centre, hn::LoadU(d, middle + x));
    auto s1 = hn::Mul(centre, hn::LoadU(d, middle + x + lanes));
    auto s2 = hn::Mul(centre, hn::LoadU(d, middle + x + 2 * lanes));
    auto s3 = hn::Mul(centre, hn::LoadU(d, middle + x + 3 * lanes));
    for (int k = 1; k <= radius; ++k) {
      const auto tap = hn::Set(d, taps[k]);
      const float* above = rows[radius - k] + x;
      const float* below = rows[radius + k] + x;
      s0 = hn::MulAdd(tap, hn::Add(hn::LoadU(d, above), hn::LoadU(d, below)), s0);
      s1 = hn::MulAdd(tap, hn::Add(hn::LoadU(d, above + lanes), hn::LoadU(d, below + lanes)), s1);
      s2 = hn::MulAdd(tap, hn::Add(hn::LoadU(d, above + 2 * lanes), hn::LoadU(d, below + 2 * lanes)), s2);
      s3 = hn::MulAdd(tap, hn::Add(hn::LoadU(d, above + 3 * lanes), hn::LoadU(d, below + 3 * lanes)), s3);
    }
    hn::StoreU(s0, d, out + x);
    hn::StoreU(s1, d, out + x + lanes);
    hn::StoreU(s2, d, out + x + 2 * lanes);
    hn::StoreU(s3, d, out + x + 3 * lanes);
  }
  for (; x < end; x += lanes) {
    const std::size_t left = end - x;
    auto sum = hn::Mul(hn::Set(d, taps[0]), LoadUpTo(d, middle + x, left));
    for (int k = 1; k <= radius; ++k) {
      const auto pair = hn::Add(LoadUpTo(d, rows[radius - k] + x, left), LoadUpTo(d, rows[radius + k] + x, left));
      sum = hn::MulAdd(hn::Set(d, taps[k]), pair, sum);
    }
    StoreUpTo(d, sum, out + x, left);
  }
}

void FilterColumnBlockTarget(const float* const* rows, const float* taps, int radius, int row_count, int count, float* out,
                             std::ptrdiff_t stride) {
  // What the rows of the block share of such a chunk stays in the first-level cache.
  constexpr std::size_t kChunk = 256;
  const std::size_t end = static_cast<std::size_t>(count);
  for (std::size_t x = 0; x < end; x += kChunk) {
    const std::size_t chunk_end = std::min(x + kChunk, end);
    for (int i = 0; i < row_count; ++i) FilterColumnsBetween(rows + i, taps, radius, x, chunk_end, out + i * stride);
  }
}

void FilterRowTarget(const float* in, const float* taps, int radius, int count, float* out) {
  const hn::ScalableTag<float> d;
  FilterRowInto(d, in, taps, radius, count,
                [&](std::size_t x, auto sum) HWY_ATTR { StoreUpTo(d, sum, out + x, static_cast<std::size_t>(count) - x); });
}

}  // namespace trem::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace trem {

HWY_EXPORT(FilterColumnBlockTarget);
HWY_EXPORT(FilterRowTarget);

void FilterColumns(const float* const* rows, const float* taps, int radius, int count, float* out) {
  FilterColumnBlock(rows, taps, radius, 1, count, out, 0);
}

void FilterColumnBlock(const float* const* rows, const float* taps, int radius, int row_count, int count, float* out,
                       std::ptrdiff_t stride) {
  HWY_DYNAMIC_DISPATCH(FilterColumnBlockTarget)(rows, taps, radius, row_count, count, out, stride);
}

void FilterRow(const float* in, const float* taps, int radius, int count, float* out) {
  HWY_DYNAMIC_DISPATCH(FilterRowTarget)(in, taps, radius, count, out);
}

}  // namespace trem
#endif  // HWY_ONCE
