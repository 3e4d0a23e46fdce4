// Goal: the output grid holds every scene, sits on multiples of its ground sample distance, and refuses absurd sizes with advice.
// Method: footprints with known bounds.
#include "mosaic/align/output_grid.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

namespace trem::align {
namespace {

using ::testing::HasSubstr;

SceneFootprint Square(double x, double y, double side) {
  return {0, 0, {Eigen::Vector2d(x, y + side), Eigen::Vector2d(x + side, y + side), Eigen::Vector2d(x + side, y), Eigen::Vector2d(x, y)}};
}

TEST(ChooseGrid, HoldsAllFootprintsWithItsOriginOnMultiplesOfTheGsd) {
  const std::vector<SceneFootprint> footprints = {Square(500010.3, 5000020.7, 30.0), Square(500055.0, 4999990.0, 10.0)};
  GridOptions options;
  options.crs_wkt = "wkt";
  const auto grid = ChooseGrid(footprints, 0.6, 3, options);
  ASSERT_TRUE(grid.ok()) << grid.status().ToString();
  EXPECT_DOUBLE_EQ(grid->gsd, 0.2);
  EXPECT_EQ(grid->crs_wkt, "wkt");
  EXPECT_NEAR(grid->origin_x / grid->gsd, std::round(grid->origin_x / grid->gsd), 1e-6);
  EXPECT_NEAR(grid->origin_y / grid->gsd, std::round(grid->origin_y / grid->gsd), 1e-6);
  for (const SceneFootprint& footprint : footprints) {
    for (const Eigen::Vector2d& corner : footprint.corners) {
      const Eigen::Vector2d pixel = grid->PixelFromWorld(corner);
      EXPECT_GE(pixel.x(), -1e-6);
      EXPECT_GE(pixel.y(), -1e-6);
      EXPECT_LE(pixel.x(), grid->width - 1 + 1e-6);
      EXPECT_LE(pixel.y(), grid->height - 1 + 1e-6);
    }
  }
  EXPECT_NEAR(grid->width, 54.7 / 0.2, 2.0) << "and not much more than they need";
  EXPECT_NEAR(grid->height, 60.7 / 0.2, 2.0);
}

TEST(ChooseGrid, TakesTheGsdThatWasAskedFor) {
  GridOptions options;
  options.gsd = 0.5;
  const std::vector<SceneFootprint> footprints = {Square(0.0, 0.0, 10.0)};
  const auto grid = ChooseGrid(footprints, 0.6, 3, options);
  ASSERT_TRUE(grid.ok());
  EXPECT_DOUBLE_EQ(grid->gsd, 0.5);
  EXPECT_EQ(grid->width, 21);
}

TEST(ChooseGrid, RefusesAMosaicThatIsTooLargeAndSaysWhatToSet) {
  const std::vector<SceneFootprint> footprints = {Square(0.0, 0.0, 10.0), Square(90000.0, 0.0, 10.0)};
  const auto grid = ChooseGrid(footprints, 0.3, 3, {});
  ASSERT_FALSE(grid.ok());
  EXPECT_EQ(grid.status().code(), StatusCode::kInvalidInput);
  EXPECT_THAT(grid.status().message(), HasSubstr("mosaic.gsd"));
}

TEST(SensorGsd, IsTheMedianFootprintOfThePixelAtTheCentre) {
  std::vector<Homography> frames(5);
  for (std::size_t k = 0; k < frames.size(); ++k) frames[k].matrix.topLeftCorner<2, 2>() *= 0.1 * static_cast<double>(k + 1);
  frames[4].matrix.topLeftCorner<2, 2>() *= 1e6;
  EXPECT_NEAR(SensorGsd(frames, 100, 80), 0.3, 1e-12);
}

}  // namespace
}  // namespace trem::align
