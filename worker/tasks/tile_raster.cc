#include "worker/tasks/tile_raster.h"

#include <limits>
#include <string>
#include <utility>

#include "mosaic/raster/geotiff.h"

namespace trem {
namespace {

constexpr const char* kIndexItem = "TREM_TILE_INDEX";

}  // namespace

Status WriteTileRaster(const std::filesystem::path& path, const MosaicGrid& grid, int tile_index, CompositeTile tile) {
  FloatRaster raster;
  raster.bands.push_back({"median", std::move(tile.median)});
  raster.bands.push_back({"count", std::move(tile.count)});
  raster.bands.push_back({"nmad", std::move(tile.nmad)});
  raster.bands.push_back({"position_sigma", std::move(tile.position_sigma)});
  raster.bands.push_back({"source", std::move(tile.source)});
  raster.grid = SubGrid(grid, grid.TileRoi(tile_index));
  raster.nodata = std::numeric_limits<double>::quiet_NaN();
  raster.metadata[kIndexItem] = std::to_string(tile_index);
  return WriteFloatRaster(path, raster);
}

Result<std::vector<Image<float>>> ReadTilePlanes(const std::filesystem::path& path, const MosaicGrid& grid, int tile_index,
                                                 const std::vector<TilePlane>& planes) {
  const Roi roi = grid.TileRoi(tile_index);
  TREM_ASSIGN_OR_RETURN(const FloatRasterInfo info, InspectFloatRaster(path));
  const auto item = info.metadata.find(kIndexItem);
  if (item == info.metadata.end() || item->second != std::to_string(tile_index) || info.width != roi.width() ||
      info.height != roi.height()) {
    return Corrupt("raster " + path.string() + " is tile " + (item == info.metadata.end() ? "(none)" : item->second) + " of " +
                   std::to_string(info.width) + " x " + std::to_string(info.height) + " pixels; expected tile " +
                   std::to_string(tile_index) + " of " + std::to_string(roi.width()) + " x " + std::to_string(roi.height()));
  }
  std::vector<int> bands;
  for (const TilePlane plane : planes) bands.push_back(static_cast<int>(plane));
  return ReadFloatBands(path, bands, std::nullopt, static_cast<long long>(kTileSideMax) * kTileSideMax);
}

std::vector<Image<float>> EmptyTilePlanes(const MosaicGrid& grid, int tile_index, const std::vector<TilePlane>& planes) {
  const Roi roi = grid.TileRoi(tile_index);
  std::vector<Image<float>> images;
  for (const TilePlane plane : planes) {
    float value = std::numeric_limits<float>::quiet_NaN();
    if (plane == TilePlane::kCount) value = 0.0f;
    if (plane == TilePlane::kSource) value = kNoSource;
    images.emplace_back(roi.width(), roi.height(), value);
  }
  return images;
}

}  // namespace trem
