// Goal: footprints stay on the visible side of the horizon and enclose what they stand for. Method: random homographies against points.
#include "mosaic/geometry/footprint.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "mosaic/base/rng.h"

namespace trem {
namespace {

TEST(Footprint, OfAnAffineMapIsTheFourOuterCornersInOrder) {
  Homography shift;
  shift.matrix(0, 2) = 10.0;
  const auto polygon = ProjectRoi(shift, {0, 0, 4, 2});
  ASSERT_EQ(polygon.size(), 4u);
  EXPECT_EQ(polygon[0], Eigen::Vector2d(9.5, -0.5));
  EXPECT_EQ(polygon[1], Eigen::Vector2d(13.5, -0.5));
  EXPECT_EQ(polygon[2], Eigen::Vector2d(13.5, 1.5));
  EXPECT_EQ(polygon[3], Eigen::Vector2d(9.5, 1.5));
  EXPECT_EQ(*BoundingRoi(polygon, {0, 0, 100, 100}), (Roi{9, 0, 15, 3}));
}

TEST(Footprint, BoundingRoiHoldsEveryVisiblePixelOfTheSource) {
  Rng rng({1});
  for (int trial = 0; trial < 300; ++trial) {
    Homography h;
    for (int i = 0; i < 9; ++i) h.matrix(i / 3, i % 3) = rng.Normal() * (i < 6 ? 1.0 : i < 8 ? 0.01 : 1.0);
    const Roi source{0, 0, 60, 40};
    const auto target_from_source = NormalisedAt(h, {30.0, 20.0});
    if (!target_from_source.ok()) continue;
    const Roi limit{-500, -500, 500, 500};
    const auto box = BoundingRoi(ProjectRoi(*target_from_source, source), limit);
    for (int y = 0; y < 40; ++y) {
      for (int x = 0; x < 60; ++x) {
        const Eigen::Vector2d at(x, y);
        if (!IsVisibleDepth(target_from_source->Depth(at))) continue;
        const Eigen::Vector2d mapped = *target_from_source * at;
        const int column = static_cast<int>(std::floor(std::clamp(mapped.x(), -1e6, 1e6) + 0.5));
        const int row = static_cast<int>(std::floor(std::clamp(mapped.y(), -1e6, 1e6) + 0.5));
        if (!limit.Contains(column, row)) continue;
        ASSERT_TRUE(box && box->Contains(column, row)) << "trial " << trial << " at " << x << " " << y;
      }
    }
  }
}

TEST(Footprint, BehindTheHorizonThereIsNothing) {
  Homography h;  // Depth = 1 - v / 10.
  h.matrix(2, 1) = -0.1;
  EXPECT_TRUE(ProjectRoi(h, {0, 20, 10, 30}).empty());
  EXPECT_EQ(ProjectRoi(h, {0, 0, 10, 30}).size(), 4u);  // Cut at the horizon.
  EXPECT_FALSE(NormalisedAt(h, {3.0, 10.0}).ok());
}

}  // namespace
}  // namespace trem
