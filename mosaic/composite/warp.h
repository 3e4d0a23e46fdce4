#pragma once

#include <utility>

#include "mosaic/base/image.h"
#include "mosaic/base/status.h"
#include "mosaic/geometry/cell_grid.h"
#include "mosaic/geometry/homography.h"
#include "mosaic/geometry/roi.h"
#include "mosaic/raster/scene_raster.h"

namespace trem {

// A scene, or the part of it that a tile needs, made ready for resampling.
struct WarpSource {
  Roi roi_in_scene;  // Cells of the scene plane that the images below hold.
  Image<float> intensity;
  Image<float> information;  // 0 where never seen or where the intensity is not finite.
  // Distance [cells] from each cell's centre to that of the nearest unseen one; beyond the scene's own raster everything is unseen, beyond
  // a part that was read nothing is known and distances are upper bounds: exact up to the margin that was read around what is needed.
  Image<float> border_distance;
};

// Takes what was read of a scene whose whole raster covers `raster_in_scene` of the scene plane. kCorrupt when the parts do not fit.
Result<WarpSource> PrepareWarp(SceneRaster raster, const Roi& raster_in_scene);

// A scene resampled onto mosaic pixels.
struct WarpedScene {
  Roi roi_in_mosaic;
  Image<float> intensity;  // NaN where invalid.
  Image<float> information;
  Image<float> border_distance;  // Cells; 0 where invalid.
  // How finely the scene samples the ground there: the squared number of cells that one mosaic pixel steps over in the direction in which
  // they are fewest (the smaller singular value of the map's derivative). 0 where invalid.
  Image<float> detail;
};

// Cells that may be needed around the cells under a pixel: half the largest kernel. PrepareWarp's part must hold them.
inline constexpr double kWarpScaleMax = 16.0;
inline constexpr int kWarpSupportCells = 34;  // 2 * kWarpScaleMax and rounding.
// Least margin that a partial read needs so that validity and distances up to `distance_cells` are those of the whole scene.
int WarpMarginCells(double distance_cells);

// Where a scene is read, and what its values are multiplied with there.
struct WarpMap {
  WarpMap(const Homography& level, CellShifts relief = {}, CellGrid<double> factors = {})  // NOLINT(google-explicit-constructor)
      : scene_from_mosaic(level), shifts(std::move(relief)), shade(std::move(factors)) {}

  Homography scene_from_mosaic;
  CellShifts shifts;       // Empty: none.
  CellGrid<double> shade;  // Empty: 1 everywhere.
};

// Resamples `source` onto the mosaic pixels of `roi_in_mosaic`. At pixel x the scene is read at s = Shifted(scene_from_mosaic * x) with
// separable normalised cubic weights (Keys, "Cubic convolution interpolation for digital image processing", IEEE ASSP 29, 1981, a = -1/2).
// Where one mosaic pixel steps over more than 1.25 cells along an axis of the scene the kernel is stretched (by the step itself from 1.75
// cells on, up to kWarpScaleMax), so that a mosaic coarser than the scene does not alias. A pixel is valid when it is on the visible side
// of the horizon and every cell with a weight other than 0 has been seen. Depends on absolute coordinates only: any tiling gives the same
// bytes. Precondition: `scene_from_mosaic` is the inverse of a map from NormalisedAt. Cost: 16 cells a pixel, 16 s^2 when stretched.
WarpedScene WarpScene(const WarpSource& source, const WarpMap& map, const Roi& roi_in_mosaic);

}  // namespace trem
