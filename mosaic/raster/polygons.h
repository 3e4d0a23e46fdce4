#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "mosaic/base/status.h"

namespace trem {

// The rings of polygons, exterior and interior alike, not closed, x = longitude or easting.
struct PolygonRings {
  std::string crs_wkt;
  std::vector<std::vector<Eigen::Vector2d>> rings;
};

// Larger files, and files with more vertices, are refused.
inline constexpr std::uintmax_t kPolygonFileBytesMax = std::uintmax_t{64} << 20;
inline constexpr std::size_t kPolygonVerticesMax = 100'000;

// Reads every Polygon and MultiPolygon of every layer of a GeoJSON or GeoPackage file. kNotFound, or kInvalidInput that names the file:
// another format, no polygon, another kind of geometry, no CRS, too large, a coordinate that is not finite.
Result<PolygonRings> ReadPolygons(const std::filesystem::path& path);

// The same rings in another CRS; long edges are split first so that they stay where they were to about a thousandth of their length.
// kInvalidInput when a vertex cannot be projected.
Result<PolygonRings> Reproject(const PolygonRings& polygons, const std::string& crs_wkt);

}  // namespace trem
