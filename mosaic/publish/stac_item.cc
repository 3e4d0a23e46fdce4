#include "mosaic/publish/stac_item.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <nlohmann/json.hpp>

#include "mosaic/raster/crs.h"
#include "mosaic/raster/geotiff.h"

namespace trem {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kExtensions[] = {
    "https://stac-extensions.github.io/projection/v1.1.0/schema.json", "https://stac-extensions.github.io/raster/v1.1.0/schema.json",
    "https://stac-extensions.github.io/file/v2.1.0/schema.json", "https://stac-extensions.github.io/processing/v1.1.0/schema.json"};
// Multihash (github.com/multiformats/multihash): code of SHA-256, then its length in bytes.
constexpr const char* kMultihashSha256 = "1220";
// Points along each side of the rectangle: a straight side of a map is bent in longitude and latitude.
constexpr int kPointsPerSide = 4;

double Rounded(double value) { return std::round(value * 1e9) / 1e9; }

// Outer edges of the grid: x_min, y_min, x_max, y_max.
std::array<double, 4> Box(const MosaicGrid& grid) {
  const double half = 0.5 * grid.gsd;
  return {grid.origin_x - half, grid.origin_y + half - grid.height * grid.gsd, grid.origin_x - half + grid.width * grid.gsd,
          grid.origin_y + half};
}

void AddProjection(const MosaicGrid& grid, Json* json) {
  (*json)["proj:shape"] = {grid.height, grid.width};
  const GeoTransform g = GeoTransformFromGrid(grid);
  // The extension's order is that of a row-major affine matrix, not GDAL's.
  (*json)["proj:transform"] = {g[1], g[2], g[0], g[4], g[5], g[3]};
}

Status AddPlace(const StacItem& item, Json* json) {
  if (!item.georeferenced) {
    (*json)["geometry"] = nullptr;
    return {};
  }
  TREM_ASSIGN_OR_RETURN(const UtmFrame frame, UtmFrame::ForCrs(item.grid.crs_wkt));
  const auto [x_min, y_min, x_max, y_max] = Box(item.grid);
  const Eigen::Vector2d corners[] = {{x_min, y_min}, {x_max, y_min}, {x_max, y_max}, {x_min, y_max}};
  Json ring = Json::array();
  double west = 360.0, south = 90.0, east = -360.0, north = -90.0;
  for (int side = 0; side < 4; ++side) {
    for (int k = 0; k < kPointsPerSide; ++k) {
      const double t = static_cast<double>(k) / kPointsPerSide;
      TREM_ASSIGN_OR_RETURN(const Eigen::Vector2d at, frame.Inverse(corners[side] + t * (corners[(side + 1) % 4] - corners[side])));
      ring.push_back({Rounded(at.y()), Rounded(at.x())});
      west = std::min(west, at.y());
      east = std::max(east, at.y());
      south = std::min(south, at.x());
      north = std::max(north, at.x());
    }
  }
  ring.push_back(ring[0]);
  (*json)["geometry"] = {{"type", "Polygon"}, {"coordinates", Json::array({ring})}};
  (*json)["bbox"] = {Rounded(west), Rounded(south), Rounded(east), Rounded(north)};
  return {};
}

Json Properties(const StacItem& item) {
  Json properties;
  properties["title"] = item.title;
  properties["description"] = item.description;
  if (item.start_s && item.end_s) {
    properties["datetime"] = Rfc3339(0.5 * (*item.start_s + *item.end_s));
    properties["start_datetime"] = Rfc3339(*item.start_s);
    properties["end_datetime"] = Rfc3339(*item.end_s);
  } else {
    properties["datetime"] = Rfc3339(0.0);
    properties["trem:datetime_known"] = false;
  }
  if (item.georeferenced) properties["gsd"] = item.grid.gsd;
  const std::optional<int> epsg = item.georeferenced ? EpsgOf(item.grid.crs_wkt) : std::nullopt;
  properties["proj:epsg"] = epsg ? Json(*epsg) : Json();
  const std::string wkt2 = item.georeferenced ? Wkt2(item.grid.crs_wkt) : "";
  properties["proj:wkt2"] = wkt2.empty() ? Json() : Json(wkt2);
  const auto box = Box(item.grid);
  properties["proj:bbox"] = {box[0], box[1], box[2], box[3]};
  AddProjection(item.grid, &properties);
  properties["processing:lineage"] = item.lineage;
  properties["processing:software"] = {{item.software, item.version}};
  return properties;
}

Json Band(const StacBand& band, double gsd, bool georeferenced) {
  Json json;
  json["description"] = band.description;
  json["data_type"] = band.data_type;
  // The extension has "nan" for what JSON has no number for.
  if (band.nodata) json["nodata"] = std::isnan(*band.nodata) ? Json("nan") : Json(*band.nodata);
  if (!band.unit.empty()) json["unit"] = band.unit;
  json["sampling"] = "area";
  if (georeferenced) json["spatial_resolution"] = gsd;
  return json;
}

Json Asset(const StacAsset& asset, const StacItem& item) {
  Json json;
  json["href"] = "./" + asset.name;
  json["title"] = asset.title;
  json["type"] = asset.media_type;
  json["roles"] = asset.roles;
  if (!asset.sha256.empty()) {
    json["file:checksum"] = kMultihashSha256 + asset.sha256;
    json["file:size"] = asset.bytes;
  }
  if (asset.grid) AddProjection(*asset.grid, &json);
  for (const StacBand& band : asset.bands) {
    json["raster:bands"].push_back(Band(band, asset.grid.value_or(item.grid).gsd, item.georeferenced));
  }
  return json;
}

}  // namespace

std::string Rfc3339(double unix_s) {
  using std::chrono::milliseconds;
  const std::chrono::sys_time<milliseconds> time{milliseconds(static_cast<long long>(std::floor(unix_s * 1000.0 + 0.5)))};
  const auto day = std::chrono::floor<std::chrono::days>(time);
  const std::chrono::year_month_day date(day);
  const std::chrono::hh_mm_ss<milliseconds> clock(time - day);
  return fmt::format("{:04}-{:02}-{:02}T{:02}:{:02}:{:02}.{:03}Z", static_cast<int>(date.year()), static_cast<unsigned>(date.month()),
                     static_cast<unsigned>(date.day()), clock.hours().count(), clock.minutes().count(), clock.seconds().count(),
                     clock.subseconds().count());
}

Result<std::string> StacItemJson(const StacItem& item) {
  Json json;
  json["type"] = "Feature";
  json["stac_version"] = "1.0.0";
  json["stac_extensions"] = kExtensions;
  json["id"] = item.id;
  TREM_RETURN_IF_ERROR(AddPlace(item, &json));
  json["properties"] = Properties(item);
  json["links"] = Json::array();
  json["assets"] = Json::object();
  for (const StacAsset& asset : item.assets) json["assets"][asset.key] = Asset(asset, item);
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace trem
