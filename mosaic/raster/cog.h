#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "mosaic/base/image.h"
#include "mosaic/base/status.h"
#include "mosaic/geometry/mosaic_grid.h"

namespace trem {

// What a Cloud Optimized GeoTIFF holds besides its pixels.
struct CogSpec {
  enum class Type { kFloat32, kInt32, kUint8, kUint16 };
  enum class Compression { kDeflate, kZstd };
  // How overviews are made: kAverage for measurements, kNearest for identifiers, which must not be mixed.
  enum class Overviews { kAverage, kNearest };

  MosaicGrid grid;  // An empty crs_wkt writes a file without CRS.
  Type type = Type::kFloat32;
  Overviews overviews = Overviews::kAverage;
  Compression compression = Compression::kDeflate;  // kZstd: readers older than GDAL 3.4 may lack it.
  std::vector<std::string> bands;                   // Descriptions; at least one.
  std::optional<double> nodata;                     // NaN for measurements, an impossible value for identifiers.
  std::map<std::string, std::string> metadata;      // Default domain.
  int threads = 1;                                  // That compress; the bytes do not depend on it.
};

// Gives the planes of tile `index` of the grid, one for each band, each of the tile's size; called once a tile, in order.
using CogTileReader = std::function<Result<std::vector<Image<float>>>(int index)>;

// Writes a Cloud Optimized GeoTIFF with GDAL's COG driver: blocks of 512, DEFLATE or ZSTD with predictor, overviews down to one block,
// BIGTIFF=IF_SAFER. Streams: tiles go to a temporary tiled TIFF beside `path` ("<path>.tiles.tif", removed at the end), from which the
// driver copies; memory is one tile and GDAL's block cache (128 MiB). Same arguments, same bytes. `path` appears directly: callers
// publish it. On failure nothing is left. kExhausted when the disk is full, kCancelled when `progress` (fraction done) returns false.
Status WriteCog(const std::filesystem::path& path, const CogSpec& spec, const CogTileReader& reader,
                const std::function<bool(double)>& progress);

}  // namespace trem
