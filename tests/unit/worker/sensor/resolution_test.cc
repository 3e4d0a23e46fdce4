// Goal: the ceiling that is reported is the least of grid, detector and optics, and says which. Method: sensors for each case.
#include "worker/sensor/resolution.h"

#include <gtest/gtest.h>

#include <cmath>
#include <string>

namespace trem {
namespace {

TEST(ResolutionCeiling, IsTheSmallestOfItsLimits) {
  const ResolutionCeiling detector = FindResolutionCeiling({0.55, 0.9}, 0.0, 3);
  EXPECT_NEAR(detector.cycles_per_px, 1.0 / 0.9, 1e-12);
  EXPECT_NE(std::string(detector.limit).find("detector"), std::string::npos);
  const ResolutionCeiling grid = FindResolutionCeiling({0.55, 0.9}, 0.0, 2);
  EXPECT_EQ(grid.cycles_per_px, 1.0);
  EXPECT_NE(std::string(grid.limit).find("grid"), std::string::npos);
  const ResolutionCeiling optics = FindResolutionCeiling({0.55, 0.9}, 1.6, 3);
  EXPECT_EQ(optics.cycles_per_px, 0.625);
  EXPECT_NE(std::string(optics.limit).find("optics"), std::string::npos);
}

TEST(ResolutionCeiling, OfAMeasuredKernelIsWhereItsTransferFunctionEnds) {
  PsfParameters file;
  file.model = PsfModel::kKernelFile;
  file.kernel = {41, 41, 6.0, {}};
  const double sigma = 0.8 * 6.0;
  for (int y = -20; y <= 20; ++y) {
    for (int x = -20; x <= 20; ++x) file.kernel.values.push_back(static_cast<float>(std::exp(-0.5 * (x * x + y * y) / (sigma * sigma))));
  }
  // exp(-2 pi^2 0.8^2 f^2) = 0.02.
  const double expected = std::sqrt(-std::log(0.02) / 2.0) / (M_PI * 0.8);
  EXPECT_NEAR(FindResolutionCeiling(file, 0.0, 3).cycles_per_px, expected, 0.015);
}

}  // namespace
}  // namespace trem
