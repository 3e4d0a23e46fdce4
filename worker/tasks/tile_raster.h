#pragma once

#include <filesystem>
#include <vector>

#include "mosaic/base/image.h"
#include "mosaic/base/status.h"
#include "mosaic/composite/tile_compositor.h"
#include "mosaic/geometry/mosaic_grid.h"

namespace trem {

// tile.tif: what COMPOSITE hands to EXPORT. A georeferenced TIFF of float32 planes in this order; intensities in internal grey levels.
enum class TilePlane { kMedian = 0, kCount = 1, kNmad = 2, kPositionSigma = 3, kSource = 4 };

// Tiles are read and written whole: with five planes of this side a task stays within its memory bound.
inline constexpr int kTileSideMax = 4096;

Status WriteTileRaster(const std::filesystem::path& path, const MosaicGrid& grid, int tile_index, CompositeTile tile);

// Reads `planes` of tile `tile_index`; kCorrupt when the file is another tile or has another size.
Result<std::vector<Image<float>>> ReadTilePlanes(const std::filesystem::path& path, const MosaicGrid& grid, int tile_index,
                                                 const std::vector<TilePlane>& planes);

// The planes of a tile of which nothing is known: what the compositor writes where no scene covers a pixel.
std::vector<Image<float>> EmptyTilePlanes(const MosaicGrid& grid, int tile_index, const std::vector<TilePlane>& planes);

}  // namespace trem
