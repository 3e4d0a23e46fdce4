#pragma once

namespace trem {

// Index of the pixel that continues an image of `size` pixels at `i` by half-sample reflection: ... b a | a b c ... y z | z y ...
inline int ReflectIndex(int i, int size) {
  if (i >= 0 && i < size) return i;
  if (i < 0 && i >= -size) return -1 - i;
  if (i >= size && i < 2 * size) return 2 * size - 1 - i;
  const int period = 2 * size;
  i %= period;
  if (i < 0) i += period;
  return i < size ? i : period - 1 - i;
}

// Fills row[x], x in [begin, end) outside [0, size), from its reflection; row[0 .. size) that it reflects to must hold values.
inline void ReflectRow(float* row, int begin, int end, int size) {
  for (int x = begin; x < 0; ++x) row[x] = row[ReflectIndex(x, size)];
  for (int x = size; x < end; ++x) row[x] = row[ReflectIndex(x, size)];
}

}  // namespace trem
