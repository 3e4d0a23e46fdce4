#pragma once

#include <Eigen/Core>
#include <vector>

#include "mosaic/composite/tile_compositor.h"
#include "mosaic/geometry/mosaic_grid.h"
#include "mosaic/geometry/roi.h"

namespace trem {

// Rings in coordinates of the mosaic's CRS, not closed. Inside is what an odd number of them surrounds, so that holes are rings too.
using CutlineRings = std::vector<std::vector<Eigen::Vector2d>>;

// Makes the pixels of `tile` (the rectangle `roi_in_mosaic` of `grid`) whose centres lie outside of the rings what nothing covers. No
// rings: nothing is cut. The same for any tiling. Cost: rows x vertices + pixels.
void ApplyCutline(const MosaicGrid& grid, const Roi& roi_in_mosaic, const CutlineRings& rings, CompositeTile* tile);

}  // namespace trem
