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

// Some rows of an image to be filtered both ways: down their columns into scratch lines, and these along themselves. All pointers are to
// column 0 of the image, wherever a row that is held begins. Beyond the image's columns the lines are continued by reflection.
struct FilterBlock {
  const float* const* rows = nullptr;  // rows[i .. i + 2 * radius] make row i of the block; row pointers may repeat.
  int row_count = 0;
  const float* taps = nullptr;
  int radius = 0;
  int begin = 0;  // Columns that are wanted; whole vectors are made from here on.
  int end = 0;
  int width = 0;  // Of the image. Columns [first, min(end + radius, width)) of the rows are read.
  int first = 0;  // At most max(begin - radius, 0).
  // kFilterLines lines of scratch memory; written from min(first, begin - radius) to end + radius + kRowSlack, read from begin - kRowSlack.
  float* lines = nullptr;
  std::ptrdiff_t stride = 0;
};
inline constexpr int kFilterLines = 4;

// out[i][x] for x in [begin, end), out[i] to column 0; writes nothing else. `out` does not overlap the input.
void FilterRows(const FilterBlock& block, float* const* out);

}  // namespace trem
