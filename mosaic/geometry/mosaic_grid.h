#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "mosaic/geometry/roi.h"

namespace trem {

// The output raster's frame. Pixel (column c, row r) has its centre at
//
//   x = origin_x + c * gsd,   y = origin_y - r * gsd       (x east / right, y north / up)
//
// in the units of `crs_wkt` (metres, or sensor pixels in a local engineering CRS). NOTE: origin is the CENTRE of the upper left
// pixel; mosaic/raster turns it into GDAL's corner convention, and nothing else does.
struct MosaicGrid {
  std::string crs_wkt;
  double origin_x = 0.0;
  double origin_y = 0.0;
  double gsd = 1.0;
  int width = 0;
  int height = 0;
  int tile_size = 512;

  Eigen::Vector2d WorldFromPixel(const Eigen::Vector2d& pixel) const { return {origin_x + pixel.x() * gsd, origin_y - pixel.y() * gsd}; }
  Eigen::Vector2d PixelFromWorld(const Eigen::Vector2d& world) const { return {(world.x() - origin_x) / gsd, (origin_y - world.y()) / gsd}; }
  int tile_columns() const { return (width + tile_size - 1) / tile_size; }
  int tile_rows() const { return (height + tile_size - 1) / tile_size; }
  int tile_count() const { return tile_columns() * tile_rows(); }
  // Pixels of tile `index` (row-major), clipped to the grid.
  Roi TileRoi(int index) const {
    const int x0 = (index % tile_columns()) * tile_size;
    const int y0 = (index / tile_columns()) * tile_size;
    return Intersect({x0, y0, x0 + tile_size, y0 + tile_size}, {0, 0, width, height});
  }
};

}  // namespace trem
