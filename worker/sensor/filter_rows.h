#pragma once

#include <cstddef>

namespace trem {

// Row kernels of a symmetric separable filter, vectorised with run-time dispatch. With c the value under the centre tap and l_k, r_k its
// neighbours k steps to either side, every output value is
//
//   taps[0] * c, then for k = 1, 2, ..., radius:  fma(taps[k], l_k + r_k, sum)
//
// in this order, so it does not depend on the vector's width, on where a row begins or on how an image is cut into tiles. Processors
// without fused multiply-add (x86 before 2013) round the product as well: there, and only there, the last bits differ.

// Floats that a row of scratch memory must have beyond the last one in use, so that kernels may read and write whole vectors.
inline constexpr int kRowSlack = 64;

// Down the columns: out[x] from rows[0 .. 2 * radius][x], rows[radius] the centre, for x in [0, count). Row pointers may repeat (a
// reflected border); `out` is none of them. Nothing is read or written outside [0, count).
void FilterColumns(const float* const* rows, const float* taps, int radius, int count, float* out);

// The same for `row_count` rows at once, out + i * stride from rows[i .. i + 2 * radius]: fewer passes over the rows than one by one.
void FilterColumnBlock(const float* const* rows, const float* taps, int radius, int row_count, int count, float* out,
                       std::ptrdiff_t stride);

// Along a row: out[x] from in[x - radius .. x + radius], for x in [0, count). `in` may be read up to in[count + radius + kRowSlack - 1];
// nothing is written outside [0, count). `out` does not overlap `in`.
void FilterRow(const float* in, const float* taps, int radius, int count, float* out);

}  // namespace trem
