// Goal: the taps are those of a Gaussian convolved with the detector's box, and sum to 1. Method: compare with numeric integration of
// the convolution, which shares no formula with the closed form.
#include "worker/sensor/psf.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <tuple>

namespace trem {
namespace {

// (Gaussian * box)(x) in cells by the midpoint rule over the box.
double IntegratedDensity(double x, double sigma, double box) {
  constexpr int kSteps = 4000;
  double sum = 0.0;
  for (int i = 0; i < kSteps; ++i) {
    const double t = x - 0.5 * box + box * (i + 0.5) / kSteps;
    sum += std::exp(-0.5 * t * t / (sigma * sigma));
  }
  return sum / (kSteps * sigma * std::sqrt(2.0 * std::numbers::pi));
}

class GaussianPsf : public ::testing::TestWithParam<std::tuple<double, double, int>> {};

TEST_P(GaussianPsf, SumsToOneAndMatchesNumericIntegration) {
  const auto [sigma_px, fill_factor, ratio] = GetParam();
  const Result<SeparablePsf> psf = MakePsf({sigma_px, fill_factor}, ratio);
  ASSERT_TRUE(psf.ok()) << psf.status().message();
  double sum = psf->taps[0];
  for (std::size_t k = 1; k < psf->taps.size(); ++k) sum += 2.0 * psf->taps[k];
  EXPECT_NEAR(sum, 1.0, 1e-6);

  double mass = 0.0;
  std::vector<double> expected;
  for (std::size_t k = 0; k < psf->taps.size(); ++k) {
    expected.push_back(IntegratedDensity(static_cast<double>(k), sigma_px * ratio, fill_factor * ratio));
    mass += (k == 0 ? 1.0 : 2.0) * expected.back();
  }
  EXPECT_NEAR(mass, 1.0, 2e-3) << "what is cut off is small, and point samples carry the mass";
  for (std::size_t k = 0; k < expected.size(); ++k) EXPECT_NEAR(psf->taps[k], expected[k] / mass, 1e-6) << "tap " << k;
}

INSTANTIATE_TEST_SUITE_P(Sensors, GaussianPsf,
                         ::testing::Values(std::tuple{0.55, 0.9, 3}, std::tuple{0.4, 1.0, 2}, std::tuple{1.2, 0.5, 4},
                                           std::tuple{0.8, 0.7, 3}));

TEST(PsfParametersTest, OutOfRangeParametersAreNamed) {
  EXPECT_NE(MakePsf({0.01, 0.9}, 3).status().message().find("psf_sigma_px"), std::string::npos);
  EXPECT_NE(MakePsf({std::numeric_limits<double>::quiet_NaN(), 0.9}, 3).status().message().find("psf_sigma_px"), std::string::npos);
  EXPECT_NE(MakePsf({0.5, 0.0}, 3).status().message().find("fill_factor"), std::string::npos);
  EXPECT_NE(MakePsf({0.5, 0.9}, 0).status().message().find("ratio"), std::string::npos);
}

}  // namespace
}  // namespace trem
