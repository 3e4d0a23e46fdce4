#pragma once

#include <array>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "mosaic/base/image.h"
#include "mosaic/base/status.h"
#include "mosaic/geometry/affine.h"
#include "mosaic/geometry/mosaic_grid.h"
#include "mosaic/geometry/roi.h"

namespace trem {

// ---- The half pixel ------------------------------------------------------------------------------------------------------------
//
// GDAL's geotransform g maps the CORNER-based pixel coordinates (P, L) to the world:
//
//   x = g[0] + P g[1] + L g[2],   y = g[3] + P g[4] + L g[5]
//
// and the centre of pixel (c, r) is at (P, L) = (c + 1/2, r + 1/2). Everywhere else in this project pixel (c, r) has its centre at
// (c, r). These functions are the only place that knows of the difference. Source: GDAL, Geotransform Tutorial.
using GeoTransform = std::array<double, 6>;

GeoTransform GeoTransformFromGrid(const MosaicGrid& grid);
// The geotransform of a raster whose "world" is another image's pixels. `target_from_pixel` maps pixel centres to pixel centres; the
// result maps corner-based coordinates to corner-based ones: (0, 0) is the upper left corner of both images, x right, y down.
GeoTransform GeoTransformFromAffine(const Affine& target_from_pixel);
// The grid (without CRS) of a north-up raster with square pixels; kInvalidInput for a rotated, sheared or anisotropic one.
Result<MosaicGrid> GridFromGeoTransform(const GeoTransform& geotransform, int width, int height);

// The grid of the sub-rectangle `roi` of `grid`: same CRS and spacing, origin moved.
MosaicGrid SubGrid(const MosaicGrid& grid, const Roi& roi);

// ---- Rasters of float32 bands ----------------------------------------------------------------------------------------------------

struct FloatBand {
  std::string description;
  Image<float> pixels;
};

struct FloatRaster {
  std::vector<FloatBand> bands;                 // All of one size.
  std::optional<MosaicGrid> grid;               // Georeference; none: a raster in its own pixels.
  std::optional<double> nodata;                 // NaN allowed.
  std::map<std::string, std::string> metadata;  // Default domain.
  // Any affine georeference, without a CRS. Not together with `grid`.
  std::optional<GeoTransform> geotransform = std::nullopt;
};

// Writes a tiled TIFF: 256 blocks, DEFLATE, floating point predictor, band-interleaved. The bytes depend on the arguments only (no
// dates, no host). The file appears under `path` directly: callers publish it (ArtefactStore::PutFile). On failure nothing is left.
// kExhausted when the disk is full.
Status WriteFloatRaster(const std::filesystem::path& path, const FloatRaster& raster);

struct FloatRasterInfo {
  int width = 0;
  int height = 0;
  int band_count = 0;
  std::map<std::string, std::string> metadata;
};

Result<FloatRasterInfo> InspectFloatRaster(const std::filesystem::path& path);

// Reads bands `bands` (counted from 0) of the rectangle `roi` (none: all), in that order. kCorrupt when the file is no TIFF of float32
// with these bands, or `roi` leaves it; kExhausted when one band of it would exceed `max_pixels`.
Result<std::vector<Image<float>>> ReadFloatBands(const std::filesystem::path& path, const std::vector<int>& bands,
                                                 const std::optional<Roi>& roi, long long max_pixels);

}  // namespace trem
