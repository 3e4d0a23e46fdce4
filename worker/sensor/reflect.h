#pragma once

namespace trem {

// Index of the pixel that continues an image of `size` pixels at `i` by half-sample reflection: ... b a | a b c ... y z | z y ...
inline int ReflectIndex(int i, int size) {
  if (i >= 0 && i < size) return i;
  const int period = 2 * size;
  i %= period;
  if (i < 0) i += period;
  return i < size ? i : period - 1 - i;
}

}  // namespace trem
