#include "mosaic/composite/cutline.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "mosaic/base/check.h"

namespace trem {
namespace {

// Columns of the mosaic, as real numbers, at which row `y` crosses the rings; rising.
void Crossings(const MosaicGrid& grid, const CutlineRings& rings, int y, std::vector<double>* columns) {
  columns->clear();
  const double world_y = grid.origin_y - y * grid.gsd;
  for (const std::vector<Eigen::Vector2d>& ring : rings) {
    for (std::size_t i = 0; i < ring.size(); ++i) {
      const Eigen::Vector2d& a = ring[i];
      const Eigen::Vector2d& b = ring[(i + 1) % ring.size()];
      // Half open, so that a vertex counts once.
      if ((a.y() <= world_y) == (b.y() <= world_y)) continue;
      const double world_x = a.x() + (world_y - a.y()) / (b.y() - a.y()) * (b.x() - a.x());
      columns->push_back((world_x - grid.origin_x) / grid.gsd);
    }
  }
  std::sort(columns->begin(), columns->end());
}

}  // namespace

void ApplyCutline(const MosaicGrid& grid, const Roi& roi_in_mosaic, const CutlineRings& rings, CompositeTile* tile) {
  if (rings.empty()) return;
  TREM_CHECK(tile->median.width() == roi_in_mosaic.width() && tile->median.height() == roi_in_mosaic.height());
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  std::vector<double> columns;
  for (int y = roi_in_mosaic.y0; y < roi_in_mosaic.y1; ++y) {
    Crossings(grid, rings, y, &columns);
    std::size_t passed = 0;
    const int row = y - roi_in_mosaic.y0;
    for (int x = roi_in_mosaic.x0; x < roi_in_mosaic.x1; ++x) {
      while (passed < columns.size() && columns[passed] <= x) ++passed;
      if (passed % 2 == 1) continue;
      const int column = x - roi_in_mosaic.x0;
      tile->median.at(column, row) = tile->nmad.at(column, row) = tile->position_sigma.at(column, row) = kNan;
      tile->count.at(column, row) = 0.0f;
      tile->source.at(column, row) = kNoSource;
    }
  }
}

}  // namespace trem
