// Goal: a cutline leaves exactly the pixels whose centres it surrounds, whatever the tiling. Method: a ring with a hole against the
// point-in-polygon rule written down by winding angle, tiles against the whole.
#include "mosaic/composite/cutline.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace trem {
namespace {

MosaicGrid Grid() {
  MosaicGrid grid;
  grid.origin_x = 100.0;
  grid.origin_y = 500.0;
  grid.gsd = 0.5;
  grid.width = 90;
  grid.height = 70;
  grid.tile_size = 32;
  return grid;
}

CompositeTile Full(const Roi& roi) {
  return {Image<float>(roi.width(), roi.height(), 5.0f), Image<float>(roi.width(), roi.height(), 3.0f),
          Image<float>(roi.width(), roi.height(), 1.0f), Image<float>(roi.width(), roi.height(), 0.5f),
          Image<float>(roi.width(), roi.height(), 7.0f)};
}

// No vertex and no edge goes through a pixel's centre, where either side would do.
const CutlineRings kRings = {{{103.0, 498.1}, {141.3, 495.2}, {128.8, 467.4}, {117.1, 488.9}, {106.2, 470.3}},
                             {{110.1, 493.1}, {116.1, 493.1}, {116.1, 490.1}, {110.1, 490.1}}};

// Whether the ring goes round the point, by the sum of the angles under which its edges are seen.
bool Surrounds(const std::vector<Eigen::Vector2d>& ring, const Eigen::Vector2d& x) {
  double angle = 0.0;
  for (std::size_t i = 0; i < ring.size(); ++i) {
    const Eigen::Vector2d a = ring[i] - x, b = ring[(i + 1) % ring.size()] - x;
    angle += std::atan2(a.x() * b.y() - a.y() * b.x(), a.dot(b));
  }
  return std::abs(angle) > std::numbers::pi;
}

TEST(Cutline, KeepsThePixelsWhoseCentresItSurrounds) {
  const MosaicGrid grid = Grid();
  const Roi all{0, 0, grid.width, grid.height};
  CompositeTile tile = Full(all);
  ApplyCutline(grid, all, kRings, &tile);
  int kept = 0;
  for (int y = 0; y < grid.height; ++y) {
    for (int x = 0; x < grid.width; ++x) {
      const Eigen::Vector2d at = grid.WorldFromPixel({static_cast<double>(x), static_cast<double>(y)});
      const bool inside = Surrounds(kRings[0], at) && !Surrounds(kRings[1], at);
      ASSERT_EQ(tile.count.at(x, y), inside ? 3.0f : 0.0f) << x << " " << y;
      ASSERT_EQ(std::isnan(tile.median.at(x, y)), !inside);
      ASSERT_EQ(std::isnan(tile.nmad.at(x, y)), !inside);
      ASSERT_EQ(std::isnan(tile.position_sigma.at(x, y)), !inside);
      ASSERT_EQ(tile.source.at(x, y), inside ? 7.0f : kNoSource);
      kept += inside ? 1 : 0;
    }
  }
  EXPECT_GT(kept, 1000);
}

TEST(Cutline, GivesTheSamePixelsForAnyTiling) {
  const MosaicGrid grid = Grid();
  const Roi all{0, 0, grid.width, grid.height};
  CompositeTile whole = Full(all);
  ApplyCutline(grid, all, kRings, &whole);
  for (int index = 0; index < grid.tile_count(); ++index) {
    const Roi roi = grid.TileRoi(index);
    CompositeTile tile = Full(roi);
    ApplyCutline(grid, roi, kRings, &tile);
    for (int y = roi.y0; y < roi.y1; ++y) {
      for (int x = roi.x0; x < roi.x1; ++x) ASSERT_EQ(tile.count.at(x - roi.x0, y - roi.y0), whole.count.at(x, y));
    }
  }
}

TEST(Cutline, WithoutRingsCutsNothing) {
  const Roi roi{0, 0, 9, 9};
  CompositeTile tile = Full(roi);
  ApplyCutline(Grid(), roi, {}, &tile);
  for (const float count : tile.count.pixels()) ASSERT_EQ(count, 3.0f);
}

}  // namespace
}  // namespace trem
