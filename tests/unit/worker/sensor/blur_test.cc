// Goal: Blur is the convolution that it claims to be, exactly symmetric with its reflected borders, whatever region is asked for.
// Method: brute-force two-dimensional convolution; <B x, y> == <x, B y> on white noise; regions against the whole.
#include "worker/sensor/blur.h"

#include <gtest/gtest.h>

#include "tests/unit/worker/sensor/random_image.h"

namespace trem {
namespace {

int Reflected(int i, int size) {
  while (i < 0 || i >= size) i = i < 0 ? -1 - i : 2 * size - 1 - i;
  return i;
}

double BruteForce(const Image<float>& image, const SeparablePsf& psf, int x, int y) {
  double sum = 0.0;
  for (int j = -psf.radius(); j <= psf.radius(); ++j) {
    for (int i = -psf.radius(); i <= psf.radius(); ++i) {
      sum += static_cast<double>(psf.taps[static_cast<std::size_t>(std::abs(i))]) * psf.taps[static_cast<std::size_t>(std::abs(j))] *
             image.at(Reflected(x + i, image.width()), Reflected(y + j, image.height()));
    }
  }
  return sum;
}

TEST(Blur, EqualsConvolutionWithReflectedBorders) {
  const SeparablePsf psf = *MakePsf({0.6, 0.9}, 3);
  // The second is narrower than the kernel: reflected more than once.
  for (const auto& [width, height] : {std::pair{31, 23}, {5, 4}, {1, 9}}) {
    const Image<float> image = RandomImage(width, height, 1);
    Image<float> out(width, height);
    Blur(psf).Apply(image, &out);
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) ASSERT_NEAR(out.at(x, y), BruteForce(image, psf, x, y), 2e-6) << x << ", " << y;
    }
  }
}

TEST(Blur, IsItsOwnAdjoint) {
  Blur blur(*MakePsf({0.6, 0.9}, 3));
  for (std::uint64_t seed = 0; seed < 8; ++seed) {
    const int width = 8 + static_cast<int>(seed) * 7;
    const Image<float> x = RandomImage(width, 29, seed);
    const Image<float> y = RandomImage(width, 29, seed + 100);
    Image<float> bx(width, 29);
    Image<float> by(width, 29);
    blur.Apply(x, &bx);
    blur.Apply(y, &by);
    EXPECT_NEAR(Dot(bx, y), Dot(x, by), 1e-6 * width * 29) << "seed " << seed;
  }
}

TEST(Blur, ARegionIsThatPartOfTheWholeAndTouchesNothingElse) {
  Blur blur(*MakePsf({0.6, 0.9}, 3));
  const Image<float> image = RandomImage(60, 50, 3);
  Image<float> whole(60, 50);
  blur.Apply(image, &whole);
  for (const Roi& region : {Roi{0, 0, 9, 50}, Roi{20, 11, 41, 30}, Roi{55, 45, 80, 70}, Roi{-5, -5, 3, 2}, Roi{70, 0, 80, 9}}) {
    Image<float> part(60, 50, -7.0F);
    blur.Apply(image, region, &part);
    for (int y = 0; y < 50; ++y) {
      for (int x = 0; x < 60; ++x) {
        ASSERT_EQ(part.at(x, y), region.Contains(x, y) ? whole.at(x, y) : -7.0F) << ToString(region) << " at " << x << ", " << y;
      }
    }
  }
}

}  // namespace
}  // namespace trem
