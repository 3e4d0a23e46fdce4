#pragma once

#include <string>

#include "mosaic/base/status.h"
#include "mosaic/geometry/mosaic_grid.h"

class GDALDataset;

namespace trem {

// Gives `dataset` the grid's CRS and corner geotransform. An empty CRS sets the geotransform only. kCorrupt when the WKT is not valid.
// Defined in geotiff.cc, beside the half pixel.
Status SetGeoreference(const MosaicGrid& grid, GDALDataset* dataset);

// Name of the CRS for people, for example "WGS 84 / UTM zone 30N"; "unnamed" when the WKT has none or is not valid.
std::string CrsName(const std::string& crs_wkt);

}  // namespace trem
