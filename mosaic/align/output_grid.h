#pragma once

#include <array>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "mosaic/align/align.h"
#include "mosaic/base/status.h"
#include "mosaic/geometry/mosaic_grid.h"

namespace trem::align {

struct GridOptions {
  std::string crs_wkt;
  double gsd = 0.0;  // 0: the sensor's / ratio.
  int tile_size = 512;
  int side_max = 200000;  // Pixels.
  // What the grid covers: x_min, y_min, x_max, y_max in the CRS; grown to whole pixels. None: all that the scenes cover.
  std::optional<std::array<double, 4>> bounds = std::nullopt;
  // What it need not leave (the cutline's rectangle), in the same order.
  std::optional<std::array<double, 4>> clip = std::nullopt;
};

// What a scene covers: the corners of its rectangle in the world, upper left, upper right, lower right, lower left of the scene.
struct SceneFootprint {
  std::uint32_t window_id = 0;
  std::uint32_t scene_id = 0;
  std::array<Eigen::Vector2d, 4> corners;
};

// The median over frames of the geometric mean footprint of a pixel at the image centre, world units. Precondition: not empty.
double SensorGsd(std::span<const Homography> world_from_sensor, int width_px, int height_px);

// The grid that holds all footprints, or the bounds: origin on a multiple of the GSD. kInvalidInput when a side exceeds `side_max` (it says
// what to set) or no footprint reaches the bounds.
Result<MosaicGrid> ChooseGrid(std::span<const SceneFootprint> footprints, double sensor_gsd, int ratio, const GridOptions& options);

}  // namespace trem::align
