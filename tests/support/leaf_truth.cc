#include "tests/support/leaf_truth.h"

#include <algorithm>
#include <cmath>

#include "mosaic/base/rng.h"

namespace trem::testing {

Image<float> LeafTruth(int width, int height, std::uint64_t seed) {
  constexpr double kRadiusMin = 1.5;
  constexpr double kRadiusMax = 150.0;
  constexpr double kLow = 1.0 / (kRadiusMax * kRadiusMax);
  constexpr double kHigh = 1.0 / (kRadiusMin * kRadiusMin);
  constexpr std::uint64_t kStream = 0x6c656166;
  Rng rng({seed, kStream});
  Image<float> truth(width, height, 128.0F);
  // The leaves' areas cover the ground so often that what was there before does not show.
  const int leaf_count = width * height / 8;
  for (int leaf = 0; leaf < leaf_count; ++leaf) {
    const double radius = 1.0 / std::sqrt(kLow + (kHigh - kLow) * rng.Uniform());
    const double cx = -radius + rng.Uniform() * (width + 2.0 * radius);
    const double cy = -radius + rng.Uniform() * (height + 2.0 * radius);
    const auto grey = static_cast<float>(40.0 + 175.0 * rng.Uniform());
    const int y_end = std::min(height - 1, static_cast<int>(cy + radius));
    for (int y = std::max(0, static_cast<int>(std::ceil(cy - radius))); y <= y_end; ++y) {
      const double half = std::sqrt(std::max(0.0, radius * radius - (y - cy) * (y - cy)));
      const int x_end = std::min(width - 1, static_cast<int>(std::floor(cx + half)));
      for (int x = std::max(0, static_cast<int>(std::ceil(cx - half))); x <= x_end; ++x) truth.at(x, y) = grey;
    }
  }
  return truth;
}

}  // namespace trem::testing
