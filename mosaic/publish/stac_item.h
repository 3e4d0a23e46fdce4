#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "mosaic/geometry/mosaic_grid.h"

namespace trem {

struct StacBand {
  std::string description;
  std::string unit;              // Empty: left out.
  std::string data_type;         // As the raster extension calls it: "float32", "uint8", "uint16", "int32".
  std::optional<double> nodata;  // NaN allowed.
};

// A file beside the item.
struct StacAsset {
  std::string name;  // File name; the item refers to it relative to itself.
  std::string key;   // Within the item.
  std::string title;
  std::string media_type;
  std::vector<std::string> roles;
  std::string sha256;  // 64 hexadecimal digits; empty: neither checksum nor size is written.
  std::uint64_t bytes = 0;
  std::vector<StacBand> bands;  // Of a raster, which has the item's grid unless `grid` says otherwise.
  std::optional<MosaicGrid> grid;
};

struct StacItem {
  std::string id;
  std::string title;
  std::string description;
  MosaicGrid grid;
  bool georeferenced = false;
  // Seconds since 1970 (UTC) of the first and the last frame. None: not known; the item says so and gives 1970-01-01T00:00:00Z, because
  // the standard wants a time.
  std::optional<double> start_s;
  std::optional<double> end_s;
  std::string software;  // "trem".
  std::string version;
  std::string lineage;  // What was done, in a sentence.
  std::vector<StacAsset> assets;
};

// A STAC Item (version 1.0.0 of the specification at stacspec.org) with the extensions projection 1.1.0, raster 1.1.0, file 2.1.0 and
// processing 1.1.0, as JSON. Georeferenced: bbox and geometry are the grid's rectangle in WGS 84. Not georeferenced: the geometry is
// null, as GeoJSON has it for what has no place on Earth. Same item, same bytes. kInvalidInput when the grid's CRS does not reach WGS 84.
Result<std::string> StacItemJson(const StacItem& item);

// "2026-01-31T12:00:00.250Z" of seconds since 1970, in whole milliseconds.
std::string Rfc3339(double unix_s);

}  // namespace trem
