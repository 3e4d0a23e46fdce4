#pragma once

#include "mosaic/base/image.h"

namespace trem {

// Limits on what is decoded, checked against the header before any pixel is allocated.
inline constexpr int kImageSideMax_px = 20000;
inline constexpr long long kImageAreaMax_px = 400LL * 1000 * 1000;

// One exposure as grey intensities in the source's grey levels; colour has become Rec. 601 luminance.
struct GreyImage {
  Image<float> pixels;
  // Full scale of the source's integer type: 255 or 65535; 0 for anything else (floating point, signed or 32-bit integers).
  double grey_max = 0.0;
};

// Rec. 601 luminance of red, green and blue.
inline float Luminance(float red, float green, float blue) { return 0.299F * red + 0.587F * green + 0.114F * blue; }

}  // namespace trem
