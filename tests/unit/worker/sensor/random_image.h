#pragma once

#include <cstdint>

#include "mosaic/base/image.h"
#include "mosaic/base/rng.h"

namespace trem {

// White noise of unit variance.
inline Image<float> RandomImage(int width, int height, std::uint64_t seed) {
  Rng rng({seed, 4711});
  Image<float> image(width, height);
  for (float& pixel : image.pixels()) pixel = static_cast<float>(rng.Normal());
  return image;
}

inline double Dot(const Image<float>& a, const Image<float>& b) {
  double sum = 0.0;
  for (std::size_t i = 0; i < a.pixels().size(); ++i) sum += static_cast<double>(a.pixels()[i]) * b.pixels()[i];
  return sum;
}

}  // namespace trem
