#pragma once

#include <array>
#include <cmath>

#include "mosaic/base/image.h"

namespace trem {

// Keys' cubic convolution, a = -1/2 (Catmull-Rom): third-order accurate. Source: R. Keys, IEEE Trans. ASSP 29(6), 1981.
// Weights of the samples at -1, 0, 1, 2 for the fraction t in [0, 1).
inline std::array<float, 4> CubicWeights(float t) {
  const float t2 = t * t;
  const float t3 = t2 * t;
  return {-0.5F * t3 + t2 - 0.5F * t, 1.5F * t3 - 2.5F * t2 + 1.0F, -1.5F * t3 + 2.0F * t2 + 0.5F * t, 0.5F * t3 - 0.5F * t2};
}

// Their derivatives with respect to t.
inline std::array<float, 4> CubicSlopes(float t) {
  const float t2 = t * t;
  return {-1.5F * t2 + 2.0F * t - 0.5F, 4.5F * t2 - 5.0F * t, -4.5F * t2 + 4.0F * t + 0.5F, 1.5F * t2 - t};
}

// True when the 4x4 support of (x, y) lies in the image.
inline bool CubicSupported(const Image<float>& image, double x, double y) {
  return x >= 1.0 && y >= 1.0 && x < image.width() - 2 && y < image.height() - 2;
}

struct ValueAndGradient {
  float value = 0.0F;
  float dx = 0.0F;
  float dy = 0.0F;
};

// Value at (x, y) [px; (0, 0) is a pixel centre]. Precondition: CubicSupported.
inline float SampleCubic(const Image<float>& image, double x, double y) {
  const int ix = static_cast<int>(x);
  const int iy = static_cast<int>(y);
  const auto wx = CubicWeights(static_cast<float>(x - ix));
  const auto wy = CubicWeights(static_cast<float>(y - iy));
  float sum = 0.0F;
  for (int j = 0; j < 4; ++j) {
    const float* p = image.row(iy - 1 + j) + ix - 1;
    sum += wy[static_cast<std::size_t>(j)] * (wx[0] * p[0] + wx[1] * p[1] + wx[2] * p[2] + wx[3] * p[3]);
  }
  return sum;
}

// Value and gradient [per px] at (x, y). Precondition: CubicSupported.
inline ValueAndGradient SampleCubicGradient(const Image<float>& image, double x, double y) {
  const int ix = static_cast<int>(x);
  const int iy = static_cast<int>(y);
  const float tx = static_cast<float>(x - ix);
  const float ty = static_cast<float>(y - iy);
  const auto wx = CubicWeights(tx);
  const auto wy = CubicWeights(ty);
  const auto sx = CubicSlopes(tx);
  const auto sy = CubicSlopes(ty);
  ValueAndGradient result;
  for (std::size_t j = 0; j < 4; ++j) {
    const float* p = image.row(iy - 1 + static_cast<int>(j)) + ix - 1;
    const float row = wx[0] * p[0] + wx[1] * p[1] + wx[2] * p[2] + wx[3] * p[3];
    const float slope = sx[0] * p[0] + sx[1] * p[1] + sx[2] * p[2] + sx[3] * p[3];
    result.value += wy[j] * row;
    result.dx += wy[j] * slope;
    result.dy += sy[j] * row;
  }
  return result;
}

}  // namespace trem
