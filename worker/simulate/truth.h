#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

#include "mosaic/base/image.h"
#include "mosaic/base/status.h"
#include "mosaic/geometry/ground_surface.h"
#include "mosaic/geometry/mosaic_grid.h"

namespace trem {

// The ground that a simulated sortie flies over: a grey raster (0..255) on a horizontal plane in a map frame, or on hills about it.
struct Truth {
  Image<float> grey;
  MosaicGrid grid;  // Of the cells; CRS in metres.
  // Height above the plane [metres] over the map, known a frame's width beyond the raster, too. Null: flat.
  std::shared_ptr<const GriddedGround> relief;

  double cell_m() const { return grid.gsd; }
  Eigen::Vector2d CellFromMap(const Eigen::Vector2d& x_in_map) const { return grid.PixelFromWorld(x_in_map); }
};

// Reads the luminance (Rec. 601) of any raster that GDAL opens; its georeference is ignored. 8-bit levels stay as they are, other types
// are scaled so that their range becomes 0..255. kNotFound / kInvalidInput name the path; at most 400 million cells, no nodata or NaN.
Result<Image<float>> ReadGrey(const std::string& path);

// A made-up place: fields with texture, roads, roofs with shadows, and boards with three-bar targets or a spoked wheel in turn: one for
// every 600 x 600 cells, `boards_min` at least. Depends on the arguments only. Precondition: at least 64 x 64 cells.
Image<float> ProceduralTerrain(int width_cells, int height_cells, std::uint64_t seed, int boards_min = 1);

// Writes the truth as a float32 GeoTIFF.
Status WriteTruth(const Truth& truth, const std::filesystem::path& path);
// Reads what WriteTruth wrote: one band, north up, square cells, a CRS.
Result<Truth> ReadTruth(const std::filesystem::path& path);

}  // namespace trem
