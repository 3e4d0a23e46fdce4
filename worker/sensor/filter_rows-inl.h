// Per-target part of the row filters; included once per SIMD target (see Highway's documentation on -inl.h files), hence no #pragma once.
#if defined(TREM_FILTER_ROWS_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef TREM_FILTER_ROWS_INL_H
#undef TREM_FILTER_ROWS_INL_H
#else
#define TREM_FILTER_ROWS_INL_H
#endif

#include <hwy/highway.h>

#include <cstddef>
#include <cstring>

HWY_BEFORE_NAMESPACE();
namespace trem::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// The first min(n, lanes) floats at `p`, zeros in the other lanes; reads nothing else.
template <class D>
HWY_INLINE hn::Vec<D> LoadUpTo(D d, const float* p, std::size_t n) {
  if (HWY_LIKELY(n >= hn::Lanes(d))) return hn::LoadU(d, p);
  HWY_ALIGN float buffer[HWY_MAX_BYTES / sizeof(float)] = {};
  std::memcpy(buffer, p, n * sizeof(float));
  return hn::Load(d, buffer);
}

// Writes the first min(n, lanes) lanes to `p` and nothing else.
template <class D>
HWY_INLINE void StoreUpTo(D d, hn::Vec<D> v, float* p, std::size_t n) {
  if (HWY_LIKELY(n >= hn::Lanes(d))) {
    hn::StoreU(v, d, p);
    return;
  }
  HWY_ALIGN float buffer[HWY_MAX_BYTES / sizeof(float)];
  hn::Store(v, d, buffer);
  std::memcpy(p, buffer, n * sizeof(float));
}

// Calls emit(x, filtered) with whole vectors for x = 0, lanes, 2 * lanes, ... < count; see FilterRow for what is read of `in`.
template <class D, class Emit>
HWY_INLINE void FilterRowInto(D d, const float* HWY_RESTRICT in, const float* HWY_RESTRICT taps, int radius, int count, const Emit& emit) {
  const std::size_t lanes = hn::Lanes(d);
  const std::size_t end = static_cast<std::size_t>(count);
  std::size_t x = 0;
  // A last group that is not full is computed whole: its four sums run side by side.
  for (; x + lanes < end; x += 4 * lanes) {
    const float* p = in + x;
    const auto centre = hn::Set(d, taps[0]);
    auto s0 = hn::Mul(centre, hn::LoadU(d, p));
    auto s1 = hn::Mul(centre, hn::LoadU(d, p + lanes));
    auto s2 = hn::Mul(centre, hn::LoadU(d, p + 2 * lanes));
    auto s3 = hn::Mul(centre, hn::LoadU(d, p + 3 * lanes));
    for (int k = 1; k <= radius; ++k) {
      const auto tap = hn::Set(d, taps[k]);
      const float* left = p - k;
      const float* right = p + k;
      s0 = hn::MulAdd(tap, hn::Add(hn::LoadU(d, left), hn::LoadU(d, right)), s0);
      s1 = hn::MulAdd(tap, hn::Add(hn::LoadU(d, left + lanes), hn::LoadU(d, right + lanes)), s1);
      s2 = hn::MulAdd(tap, hn::Add(hn::LoadU(d, left + 2 * lanes), hn::LoadU(d, right + 2 * lanes)), s2);
      s3 = hn::MulAdd(tap, hn::Add(hn::LoadU(d, left + 3 * lanes), hn::LoadU(d, right + 3 * lanes)), s3);
    }
    emit(x, s0);
    emit(x + lanes, s1);
    if (x + 2 * lanes < end) emit(x + 2 * lanes, s2);
    if (x + 3 * lanes < end) emit(x + 3 * lanes, s3);
  }
  for (; x < end; x += lanes) {
    auto sum = hn::Mul(hn::Set(d, taps[0]), hn::LoadU(d, in + x));
    for (int k = 1; k <= radius; ++k) {
      sum = hn::MulAdd(hn::Set(d, taps[k]), hn::Add(hn::LoadU(d, in + x - k), hn::LoadU(d, in + x + k)), sum);
    }
    emit(x, sum);
  }
}

}  // namespace trem::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();
#endif  // TREM_FILTER_ROWS_INL_H
