// Per-target part of bicubic sampling; included once per SIMD target (see Highway's documentation on -inl.h files), hence no #pragma once.
#if defined(TREM_BICUBIC_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef TREM_BICUBIC_INL_H
#undef TREM_BICUBIC_INL_H
#else
#define TREM_BICUBIC_INL_H
#endif

#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace trem::HWY_NAMESPACE {

// A row of the 4 x 4 supports of several pixels: four cells each, of as many pixels as fill a vector. What is done to a lane does not
// depend on how many there are.
#if HWY_TARGET == HWY_SCALAR
inline constexpr int kSupports = 0;  // Vectors hold less than one.
#else
#if HWY_HAVE_SCALABLE
using Supports = hwy::HWY_NAMESPACE::FixedTag<float, 4>;
#else
using Supports = hwy::HWY_NAMESPACE::CappedTag<float, 16>;
#endif
inline constexpr int kSupports = static_cast<int>(hwy::HWY_NAMESPACE::MaxLanes(Supports())) / 4;

// Cells first[k] .. first[k] + 3 of `row` in lanes 4 k .. 4 k + 3: one load a pixel, which is cheaper than any gather.
template <class D>
HWY_INLINE hwy::HWY_NAMESPACE::Vec<D> LoadSupports(D d, const float* row, const int* first) {
  namespace hn = hwy::HWY_NAMESPACE;
  if constexpr (hn::MaxLanes(d) <= 4) {
    return hn::LoadU(d, row + *first);
  } else {
    const hn::Half<D> half;
    return hn::Combine(d, LoadSupports(half, row, first + hn::MaxLanes(half) / 4), LoadSupports(half, row, first));
  }
}
#endif

}  // namespace trem::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();
#endif  // TREM_BICUBIC_INL_H
