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

#include "worker/sensor/filter_rows.h"
#include "worker/sensor/reflect.h"

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

#endif

// The taps in registers, as far as their number is known.
template <int kRadius, class D>
struct Taps {
  Taps(D d, const float* values) {
    for (int k = 0; k <= kRadius; ++k) tap[k] = hn::Set(d, values[k]);
  }
  hn::Vec<D> tap[kRadius + 1];
};

// Rows that are filtered together: of their 2 * radius + kRowsTogether rows of input each vector is loaded once, into registers.
constexpr int kRowsTogether = HWY_TARGET <= HWY_AVX3 ? 4 : 2;

// Column x of kRows rows, down the columns: store(i, sum). kRadius 0: any radius.
template <int kRows, int kRadius, class D, class Load, class Store>
HWY_INLINE void FilterColumnsAt(D d, const float* const* rows, const Taps<kRadius, D>& known, const float* HWY_RESTRICT taps, int radius,
                                std::ptrdiff_t x, const Load& load, const Store& store) {
  using V = hn::Vec<D>;
  if constexpr (kRadius > 0) {
    V in[2 * kRadius + kRows];
    for (int j = 0; j < 2 * kRadius + kRows; ++j) in[j] = load(rows[j] + x);
    for (int i = 0; i < kRows; ++i) {
      V sum = hn::Mul(known.tap[0], in[i + kRadius]);
      for (int k = 1; k <= kRadius; ++k) sum = hn::MulAdd(known.tap[k], hn::Add(in[i + kRadius - k], in[i + kRadius + k]), sum);
      store(i, sum);
    }
  } else {
    for (int i = 0; i < kRows; ++i) {
      const float* const* centre = rows + i + radius;
      V sum = hn::Mul(hn::Set(d, taps[0]), load(centre[0] + x));
      for (int k = 1; k <= radius; ++k) sum = hn::MulAdd(hn::Set(d, taps[k]), hn::Add(load(centre[-k] + x), load(centre[k] + x)), sum);
      store(i, sum);
    }
  }
}

// Calls emit(x, filtered) with whole vectors for x = block.begin, ... < block.end of a line.
template <int kRadius, class D, class Emit>
HWY_INLINE void FilterRowInto(D d, const float* HWY_RESTRICT line, const FilterBlock& block, const Taps<kRadius, D>& known,
                              const Emit& emit) {
  const int lanes = static_cast<int>(hn::Lanes(d));
  const int end = block.end;
#if TREM_FILTER_SHIFTS
  if constexpr (kRadius > 0) {
    auto before = hn::LoadU(d, line + block.begin - lanes);
    auto centre = hn::LoadU(d, line + block.begin);
    for (int x = block.begin; x < end; x += lanes) {
      const auto after = hn::LoadU(d, line + x + lanes);
      emit(x, AddPairs<1, kRadius>(before, centre, after, known.tap, hn::Mul(known.tap[0], centre)));
      before = centre;
      centre = after;
    }
    return;
  }
#endif
  for (int x = block.begin; x < end; x += lanes) {
    const float* p = line + x;
    if constexpr (kRadius > 0) {
      auto sum = hn::Mul(known.tap[0], hn::LoadU(d, p));
      for (int k = 1; k <= kRadius; ++k) sum = hn::MulAdd(known.tap[k], hn::Add(hn::LoadU(d, p - k), hn::LoadU(d, p + k)), sum);
      emit(x, sum);
    } else {
      auto sum = hn::Mul(hn::Set(d, block.taps[0]), hn::LoadU(d, p));
      for (int k = 1; k <= block.radius; ++k) {
        sum = hn::MulAdd(hn::Set(d, block.taps[k]), hn::Add(hn::LoadU(d, p - k), hn::LoadU(d, p + k)), sum);
      }
      emit(x, sum);
    }
  }
}

// Rows row .. row + kRows - 1 of a block, down the columns into lines that stay in the first-level cache, and these along themselves.
template <int kRows, int kRadius, class D, class RowEmit>
HWY_INLINE void FilterGroup(D d, const FilterBlock& block, int row, const RowEmit& row_emit) {
  const int lanes = static_cast<int>(hn::Lanes(d));
  const int radius = kRadius > 0 ? kRadius : block.radius;
  const Taps<kRadius, D> known(d, block.taps);
  const float* const* rows = block.rows + row;
  const int columns_end = block.end + radius < block.width ? block.end + radius : block.width;
  const auto store = [&](int x) HWY_ATTR {
    return [&block, d, x](int i, hn::Vec<D> sum) HWY_ATTR { hn::StoreU(sum, d, block.lines + i * block.stride + x); };
  };
  for (int column = block.first; column < columns_end; column += lanes) {
    if (HWY_LIKELY(column + lanes <= columns_end)) {
      FilterColumnsAt<kRows, kRadius>(
          d, rows, known, block.taps, radius, column, [d](const float* p) HWY_ATTR { return hn::LoadU(d, p); }, store(column));
    } else {
      const std::size_t rest = static_cast<std::size_t>(columns_end - column);
      FilterColumnsAt<kRows, kRadius>(
          d, rows, known, block.taps, radius, column, [d, rest](const float* p) HWY_ATTR { return LoadUpTo(d, p, rest); }, store(column));
    }
  }
  for (int i = 0; i < kRows; ++i) {
    float* const line = block.lines + i * block.stride;
    ReflectRow(line, block.begin - radius, block.end + radius, block.width);
    FilterRowInto<kRadius>(d, line, block, known, row_emit(row + i));
  }
}

// For every row i of the block, with emit = row_emit(i): calls emit(x, filtered) with whole vectors for x = begin, begin + lanes, ... <
// end.
template <class D, class RowEmit>
HWY_INLINE void FilterBlockInto(D d, const FilterBlock& block, const RowEmit& row_emit) {
  static_assert(kRowsTogether <= kFilterLines);
  WithRadius(block.radius, [&](auto known) HWY_ATTR {
    constexpr int kRadius = decltype(known)::value;
    int row = 0;
    for (; row + kRowsTogether <= block.row_count; row += kRowsTogether) FilterGroup<kRowsTogether, kRadius>(d, block, row, row_emit);
    for (; row < block.row_count; ++row) FilterGroup<1, kRadius>(d, block, row, row_emit);
  });
}

}  // namespace trem::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();
#endif  // TREM_FILTER_ROWS_INL_H
