// Goal: the places that a report enlarges are covered and have the most detail. Method: a flat plane with patches of known contrast and
// a hole, given in rectangles.
#include "mosaic/publish/detail_finder.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <limits>

namespace trem {
namespace {

Image<float> Plane(int width, int height) {
  Image<float> plane(width, height, 100.0f);
  const auto patch = [&](int x0, int y0, float contrast) {
    for (int y = y0; y < y0 + 40; ++y) {
      for (int x = x0; x < x0 + 40; ++x) plane.at(x, y) += (x + y) % 2 == 0 ? contrast : -contrast;
    }
  };
  patch(40, 40, 20.0f);
  patch(260, 60, 30.0f);
  patch(60, 240, 10.0f);
  patch(250, 250, 90.0f);
  plane.at(270, 270) = std::numeric_limits<float>::quiet_NaN();  // The strongest patch has a hole.
  return plane;
}

TEST(DetailFinder, FindsTheStrongestCoveredPatchesInOrder) {
  const Image<float> plane = Plane(320, 320);
  DetailFinder finder(40);
  finder.Add({1000, 2000, 1320, 2320}, plane);
  const std::vector<Roi> best = finder.Best(3);
  ASSERT_EQ(best.size(), 3u);
  const Eigen::Vector2d centres[] = {{1280.0, 2080.0}, {1060.0, 2060.0}, {1080.0, 2260.0}};
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(best[i].width(), 40);
    EXPECT_NEAR(0.5 * (best[i].x0 + best[i].x1), centres[i].x(), 21.0) << i;
    EXPECT_NEAR(0.5 * (best[i].y0 + best[i].y1), centres[i].y(), 21.0) << i;
  }
}

TEST(DetailFinder, FindsNothingWhereNothingIsCovered) {
  DetailFinder finder(16);
  finder.Add({0, 0, 100, 100}, Image<float>(100, 100, std::numeric_limits<float>::quiet_NaN()));
  EXPECT_TRUE(finder.Best(3).empty());
  finder.Add({100, 0, 110, 10}, Image<float>(10, 10, 1.0f));  // Smaller than a square.
  EXPECT_TRUE(finder.Best(3).empty());
}

}  // namespace
}  // namespace trem
