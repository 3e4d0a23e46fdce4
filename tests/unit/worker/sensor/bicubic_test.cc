// Goal: cubic sampling is what the order of accuracy of the engine rests on. Method: exactness on quadratics, the gradient against
// finite differences of the value, and the limits of the support.
#include "worker/sensor/bicubic.h"

#include <gtest/gtest.h>

#include "tests/unit/worker/sensor/random_image.h"

namespace trem {
namespace {

double Quadratic(double x, double y) { return 3.0 - 0.7 * x + 0.4 * y + 0.25 * x * x - 0.15 * x * y + 0.1 * y * y; }

TEST(Bicubic, ReproducesQuadraticsAndTheirGradient) {
  Image<float> image(12, 11);
  for (int y = 0; y < 11; ++y) {
    for (int x = 0; x < 12; ++x) image.at(x, y) = static_cast<float>(Quadratic(x, y));
  }
  Rng rng({1});
  for (int k = 0; k < 200; ++k) {
    const double x = 1.0 + 8.99 * rng.Uniform();
    const double y = 1.0 + 7.99 * rng.Uniform();
    const ValueAndGradient sample = SampleCubicGradient(image, x, y);
    EXPECT_NEAR(sample.value, Quadratic(x, y), 2e-5);
    EXPECT_NEAR(sample.dx, -0.7 + 0.5 * x - 0.15 * y, 5e-5);
    EXPECT_NEAR(sample.dy, 0.4 - 0.15 * x + 0.2 * y, 5e-5);
    EXPECT_FLOAT_EQ(SampleCubic(image, x, y), sample.value);
  }
}

TEST(Bicubic, TheGradientIsThatOfTheValue) {
  const Image<float> image = RandomImage(12, 12, 7);
  constexpr double kStep = 0.01;
  Rng rng({2});
  for (int k = 0; k < 200; ++k) {
    // Away from pixel centres, where the second derivative jumps.
    const double x = 1.0 + rng.UniformIndex(8) + 0.05 + 0.9 * rng.Uniform();
    const double y = 1.0 + rng.UniformIndex(8) + 0.05 + 0.9 * rng.Uniform();
    const ValueAndGradient sample = SampleCubicGradient(image, x, y);
    EXPECT_NEAR(sample.dx, (SampleCubic(image, x + kStep, y) - SampleCubic(image, x - kStep, y)) / (2.0 * kStep), 2e-3);
    EXPECT_NEAR(sample.dy, (SampleCubic(image, x, y + kStep) - SampleCubic(image, x, y - kStep)) / (2.0 * kStep), 2e-3);
  }
}

TEST(Bicubic, InterpolatesAndKnowsItsSupport) {
  const Image<float> image = RandomImage(9, 8, 3);
  EXPECT_EQ(SampleCubic(image, 4.0, 3.0), image.at(4, 3));
  EXPECT_TRUE(CubicSupported(image, 1.0, 1.0));
  EXPECT_TRUE(CubicSupported(image, 6.999, 5.999));
  EXPECT_FALSE(CubicSupported(image, 0.999, 3.0));
  EXPECT_FALSE(CubicSupported(image, 7.0, 3.0));
  EXPECT_FALSE(CubicSupported(image, 3.0, 6.0));
  EXPECT_FALSE(CubicSupported(image, std::nan(""), 3.0));
}

}  // namespace
}  // namespace trem
