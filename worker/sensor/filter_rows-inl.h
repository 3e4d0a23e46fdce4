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
#include <type_traits>

HWY_BEFORE_NAMESPACE();
namespace trem::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// The first min(n, lanes) floats at `p`, zeros in the other lanes; reads nothing else.
template <class D>
HWY_INLINE hn::Vec<D> LoadUpTo(D d, const float* p, std::size_t n) {
  if (HWY_LIKELY(n >= hn::Lanes(d))) return hn::LoadU(d, p);
#if HWY_TARGET <= HWY_AVX2
  return hn::MaskedLoad(hn::FirstN(d, n), d, p);
#else
  HWY_ALIGN float buffer[HWY_MAX_BYTES / sizeof(float)] = {};
  std::memcpy(buffer, p, n * sizeof(float));
  return hn::Load(d, buffer);
#endif
}

// Writes the first min(n, lanes) lanes to `p` and nothing else.
template <class D>
HWY_INLINE void StoreUpTo(D d, hn::Vec<D> v, float* p, std::size_t n) {
  if (HWY_LIKELY(n >= hn::Lanes(d))) {
    hn::StoreU(v, d, p);
    return;
  }
#if HWY_TARGET <= HWY_AVX2
  hn::BlendedStore(v, hn::FirstN(d, n), d, p);
#else
  HWY_ALIGN float buffer[HWY_MAX_BYTES / sizeof(float)];
  hn::Store(v, d, buffer);
  std::memcpy(p, buffer, n * sizeof(float));
#endif
}

// Lanes kFrom, kFrom + 1, ... of `low` followed by `high`, vectors of 16 lanes.
#undef TREM_FILTER_SHIFTS
#if HWY_TARGET <= HWY_AVX3
#define TREM_FILTER_SHIFTS 1
template <int kFrom, class V>
HWY_INLINE V LanesFrom(V low, V high) {
  return V{_mm512_castsi512_ps(_mm512_alignr_epi32(_mm512_castps_si512(high.raw), _mm512_castps_si512(low.raw), kFrom))};
}
#else
#define TREM_FILTER_SHIFTS 0
#endif

// Calls call(std::integral_constant<int, radius>) for the radii that filters have in practice, so that their loops are unrolled, and with 0
// for any other.
template <class Call>
HWY_INLINE void WithRadius(int radius, const Call& call) {
  switch (radius) {
    case 1:
      return call(std::integral_constant<int, 1>());
    case 2:
      return call(std::integral_constant<int, 2>());
    case 3:
      return call(std::integral_constant<int, 3>());
    case 4:
      return call(std::integral_constant<int, 4>());
    case 5:
      return call(std::integral_constant<int, 5>());
    case 6:
      return call(std::integral_constant<int, 6>());
    case 7:
      return call(std::integral_constant<int, 7>());
    case 8:
      return call(std::integral_constant<int, 8>());
    case 9:
      return call(std::integral_constant<int, 9>());
    default:
      return call(std::integral_constant<int, 0>());
  }
}

#if TREM_FILTER_SHIFTS

// sum + taps[k] (left + right), k = kFirst .. kRadius, the neighbours taken out of registers: a load that straddles two cache lines, as all
// but one of an unaligned row do, costs twice a shift.
template <int kK, int kRadius, class V>
HWY_INLINE V AddPairs(V before, V centre, V after, const V* taps, V sum) {
  if constexpr (kK > kRadius) {
    return sum;
  } else {
    const V pair = hn::Add(LanesFrom<16 - kK>(before, centre), LanesFrom<kK>(centre, after));
    return AddPairs<kK + 1, kRadius>(before, centre, after, taps, hn::MulAdd(taps[kK], pair, sum));
  }
}

template <int kRadius, class D, class Emit>
HWY_INLINE void FilterRowOfRadius(D d, const float* HWY_RESTRICT in, const float* HWY_RESTRICT taps, int count, const Emit& emit) {
  static_assert(kRadius > 0 && kRadius < 16);
  using V = hn::Vec<D>;
  V tap[kRadius + 1];
  for (int k = 0; k <= kRadius; ++k) tap[k] = hn::Set(d, taps[k]);
  V before = hn::MaskedLoad(hn::Not(hn::FirstN(d, 16 - kRadius)), d, in - 16);
  V centre = hn::LoadU(d, in);
  const std::size_t end = static_cast<std::size_t>(count);
  for (std::size_t x = 0; x < end; x += 16) {
    const V after = hn::LoadU(d, in + x + 16);
    emit(x, AddPairs<1, kRadius>(before, centre, after, tap, hn::Mul(tap[0], centre)));
    before = centre;
    centre = after;
  }
}

#endif

// Four sums at a time run side by side; kRadius 0: any radius.
template <int kRadius, class D, class Emit>
HWY_INLINE void FilterRowByLoads(D d, const float* HWY_RESTRICT in, const float* HWY_RESTRICT taps, int any_radius, int count,
                                 const Emit& emit) {
  const int radius = kRadius > 0 ? kRadius : any_radius;
  const std::size_t lanes = hn::Lanes(d);
  const std::size_t end = static_cast<std::size_t>(count);
  std::size_t x = 0;
  // A last group that is not full is computed whole.
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

// Calls emit(x, filtered) with whole vectors for x = 0, lanes, 2 * lanes, ... < count; see FilterRow for what is read of `in`.
template <class D, class Emit>
HWY_INLINE void FilterRowInto(D d, const float* HWY_RESTRICT in, const float* HWY_RESTRICT taps, int radius, int count, const Emit& emit) {
  WithRadius(radius, [&](auto known) HWY_ATTR {
    constexpr int kRadius = decltype(known)::value;
#if TREM_FILTER_SHIFTS
    if constexpr (kRadius > 0) return FilterRowOfRadius<kRadius>(d, in, taps, count, emit);
#endif
    FilterRowByLoads<kRadius>(d, in, taps, radius, count, emit);
  });
}

}  // namespace trem::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();
#endif  // TREM_FILTER_ROWS_INL_H
