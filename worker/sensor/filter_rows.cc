#include "worker/sensor/filter_rows.h"

#include <algorithm>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "worker/sensor/filter_rows.cc"
#include <hwy/foreach_target.h>
// After foreach_target.h, which includes this file again for every target.
#include "worker/sensor/filter_rows-inl.h"

HWY_BEFORE_NAMESPACE();
namespace trem::HWY_NAMESPACE {

// Rows that are filtered together: of their 2 * radius + kRowsTogether rows of input each vector is loaded once, into registers.
constexpr int kRowsTogether = HWY_TARGET <= HWY_AVX3 ? 4 : 2;

// Columns [begin, end) of kRows rows. kRadius 0: any radius.
template <int kRows, int kRadius>
HWY_INLINE void FilterColumnsBetween(const float* const* rows, const float* HWY_RESTRICT taps, int any_radius, std::size_t begin,
                                     std::size_t end, float* HWY_RESTRICT out, std::ptrdiff_t stride) {
  const hn::ScalableTag<float> d;
  using V = hn::Vec<decltype(d)>;
  const int radius = kRadius > 0 ? kRadius : any_radius;
  const auto filter = [&](std::size_t x, const auto& load, const auto& store) HWY_ATTR {
    if constexpr (kRadius > 0) {
      V in[2 * kRadius + kRows];
      for (int j = 0; j < 2 * kRadius + kRows; ++j) in[j] = load(rows[j] + x);
      for (int i = 0; i < kRows; ++i) {
        V sum = hn::Mul(hn::Set(d, taps[0]), in[i + kRadius]);
        for (int k = 1; k <= kRadius; ++k) sum = hn::MulAdd(hn::Set(d, taps[k]), hn::Add(in[i + kRadius - k], in[i + kRadius + k]), sum);
        store(sum, out + i * stride + static_cast<std::ptrdiff_t>(x));
      }
    } else {
      for (int i = 0; i < kRows; ++i) {
        const float* const* centre = rows + i + radius;
        V sum = hn::Mul(hn::Set(d, taps[0]), load(centre[0] + x));
        for (int k = 1; k <= radius; ++k) sum = hn::MulAdd(hn::Set(d, taps[k]), hn::Add(load(centre[-k] + x), load(centre[k] + x)), sum);
        store(sum, out + i * stride + static_cast<std::ptrdiff_t>(x));
      }
    }
  };
  const std::size_t lanes = hn::Lanes(d);
  std::size_t x = begin;
  for (; x + lanes <= end; x += lanes) {
    filter(
        x, [&](const float* p) HWY_ATTR { return hn::LoadU(d, p); }, [&](V v, float* p) HWY_ATTR { hn::StoreU(v, d, p); });
  }
  if (x == end) return;
  filter(
      x, [&](const float* p) HWY_ATTR { return LoadUpTo(d, p, end - x); }, [&](V v, float* p) HWY_ATTR { StoreUpTo(d, v, p, end - x); });
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
