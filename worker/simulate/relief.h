#pragma once

#include <filesystem>
#include <memory>

#include "mosaic/base/status.h"
#include "mosaic/geometry/ground_surface.h"
#include "mosaic/geometry/mosaic_grid.h"
#include "worker/simulate/options.h"

namespace trem {

// Rolling hills over the truth's grid and half its size beyond: a sum of waves about as long as the truth is wide, between
// -relief_m / 2 and relief_m / 2 [metres] over the map. Null when options.relief_m is 0. Depends on options.relief_m, seed and grid.
std::shared_ptr<const GriddedGround> MakeRelief(const SimulationOptions& options, const MosaicGrid& grid);

// As a GeoTIFF of elevations (relief + ground_elevation_m) in the grid's CRS, and back.
Status WriteRelief(const GriddedGround& relief, double ground_elevation_m, const std::string& crs_wkt, const std::filesystem::path& path);
Result<std::shared_ptr<const GriddedGround>> ReadRelief(const std::filesystem::path& path, double ground_elevation_m);

}  // namespace trem
