#pragma once

#include <filesystem>

#include "mosaic/base/status.h"
#include "mosaic/geometry/ground_surface.h"
#include "mosaic/raster/crs.h"

namespace trem {

// Nodes along a side of what is kept of an elevation model.
inline constexpr int kElevationNodesMax = 512;

// A rectangle of longitudes and latitudes, WGS 84 degrees.
struct GeographicBounds {
  double west_deg = 0.0;
  double south_deg = 0.0;
  double east_deg = 0.0;
  double north_deg = 0.0;
};

// Cuts `bounds` out of band 1 of any local raster that GDAL reads and that has a coordinate system and a geotransform: elevations at a grid
// of longitudes (x) and latitudes (y), in degrees, bilinear between the raster's pixel centres, at about the raster's own spacing or as
// fine as `nodes_max` a side allow. Memory: the raster's pixels within `bounds`, read at no more than four times `nodes_max` a side.
// kNotFound: no such file. kInvalidInput that names the file: no raster, no CRS, no pixel with a value within `bounds` (says what the
// raster covers and what was wanted).
Result<GriddedGround> ReadElevationModel(const std::filesystem::path& path, const GeographicBounds& bounds,
                                         int nodes_max = kElevationNodesMax);

// The same surface over a working world of metres: x_in_map = origin + scale * x_in_world, with `map` as the map. Resampled to a grid
// of the geographic one's spacing that covers its footprint.
Result<GriddedGround> GroundInWorld(const GriddedGround& geographic, const UtmFrame& map, const Eigen::Vector2d& origin, double scale);

}  // namespace trem
