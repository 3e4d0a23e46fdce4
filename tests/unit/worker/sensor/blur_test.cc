// Goal: Blur is the convolution that it claims to be for every kind of PSF, and ApplyAdjoint its exact adjoint under the same reflected
// borders, whatever region is asked for. Method: brute-force two-dimensional convolution; <B x, y> == <x, B' y> on white noise; regions
// against the whole.
#include "worker/sensor/blur.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/unit/worker/sensor/random_image.h"
#include "tests/unit/worker/sensor/sample_psfs.h"

namespace trem {
namespace {

int Reflected(int i, int size) {
  while (i < 0 || i >= size) i = i < 0 ? -1 - i : 2 * size - 1 - i;
  return i;
}

double BruteForce(const Image<float>& image, const Eigen::MatrixXd& kernel, int x, int y) {
  const int radius = static_cast<int>(kernel.rows() / 2);
  double sum = 0.0;
  for (int j = -radius; j <= radius; ++j) {
    for (int i = -radius; i <= radius; ++i) {
      sum += kernel(j + radius, i + radius) * image.at(Reflected(x - i, image.width()), Reflected(y - j, image.height()));
    }
  }
  return sum;
}

TEST(Blur, EqualsConvolutionWithReflectedBorders) {
  for (const auto& [name, psf] : SamplePsfs()) {
    const Eigen::MatrixXd kernel = KernelOf(psf);
    // The second is narrower than the kernel: reflected more than once.
    for (const auto& [width, height] : {std::pair{31, 23}, {5, 4}, {1, 9}}) {
      const Image<float> image = RandomImage(width, height, 1);
      Image<float> out(width, height);
      Blur(psf).Apply(image, &out);
      for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; ++x) ASSERT_NEAR(out.at(x, y), BruteForce(image, kernel, x, y), 2e-6) << name << " at " << x << ", " << y;
      }
    }
  }
}

TEST(Blur, TheAdjointIsTheAdjoint) {
  for (const auto& [name, psf] : SamplePsfs()) {
    Blur blur(psf);
    for (std::uint64_t seed = 0; seed < 6; ++seed) {
      const int width = 3 + static_cast<int>(seed) * 11;
      const Image<float> x = RandomImage(width, 29, seed);
      const Image<float> y = RandomImage(width, 29, seed + 100);
      Image<float> bx(width, 29);
      Image<float> by(width, 29);
      blur.Apply(x, &bx);
      blur.ApplyAdjoint(y, &by);
      EXPECT_NEAR(Dot(bx, y), Dot(x, by), 1e-6 * width * 29) << name << ", seed " << seed;
    }
  }
}

// The adjoint of a kernel that is not symmetric is neither B nor B with the kernel turned: at the borders what was reflected folds back.
TEST(Blur, AnAsymmetricKernelIsNotItsOwnAdjoint) {
  Blur blur(SamplePsfs().at("asymmetric file"));
  const Image<float> x = RandomImage(29, 29, 1);
  const Image<float> y = RandomImage(29, 29, 2);
  Image<float> bx(29, 29);
  Image<float> by(29, 29);
  blur.Apply(x, &bx);
  blur.Apply(y, &by);
  EXPECT_GT(std::abs(Dot(bx, y) - Dot(x, by)), 0.01);
}

TEST(Blur, ARegionIsThatPartOfTheWholeAndTouchesNothingElse) {
  const Image<float> image = RandomImage(60, 50, 3);
  for (const auto& [name, psf] : SamplePsfs()) {
    Blur blur(psf);
    Image<float> whole(60, 50);
    Image<float> whole_adjoint(60, 50);
    blur.Apply(image, &whole);
    blur.ApplyAdjoint(image, &whole_adjoint);
    for (const Roi& region : {Roi{0, 0, 9, 50}, Roi{20, 11, 41, 30}, Roi{55, 45, 80, 70}, Roi{-5, -5, 3, 2}, Roi{70, 0, 80, 9}}) {
      Image<float> part(60, 50, -7.0F);
      Image<float> part_adjoint(60, 50, -7.0F);
      blur.Apply(image, region, &part);
      blur.ApplyAdjoint(image, region, &part_adjoint);
      for (int y = 0; y < 50; ++y) {
        for (int x = 0; x < 60; ++x) {
          const bool inside = region.Contains(x, y);
          ASSERT_EQ(part.at(x, y), inside ? whole.at(x, y) : -7.0F) << name << ", " << ToString(region) << " at " << x << ", " << y;
          ASSERT_EQ(part_adjoint.at(x, y), inside ? whole_adjoint.at(x, y) : -7.0F) << name << ", " << ToString(region) << " at " << x << ", " << y;
        }
      }
    }
  }
}

}  // namespace
}  // namespace trem
