#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "mosaic/base/image.h"
#include "mosaic/base/status.h"
#include "mosaic/composite/median.h"
#include "mosaic/geometry/cell_grid.h"
#include "mosaic/geometry/homography.h"
#include "mosaic/geometry/mosaic_grid.h"
#include "mosaic/geometry/roi.h"
#include "mosaic/raster/scene_raster.h"

namespace trem {

// One aligned scene, without its pixels.
struct CompositeScene {
  std::uint32_t window_id = 0;
  std::uint32_t scene_id = 0;
  Homography world_from_scene;  // World coordinates of the mosaic's CRS from cells of the scene plane.
  CellShifts shifts;            // What relief adds to it; see cell_grid.h. Empty: nothing.
  CellGrid<double> shade;       // Factors on the intensity before gain and offset, over cells of the scene plane. Empty: none.
  Roi raster_in_scene;          // Cells that the scene's raster holds.
  double gain = 1.0;            // Balanced intensity = gain * scene + offset.
  double offset = 0.0;
  double position_sigma = 0.0;  // CRS units.
};

struct CompositeOptions {
  // Distance over which a scene fades in from its border, cells (16 sensor pixels at 3 cells a pixel). Larger: softer seams, but fewer
  // scenes count fully where the overlaps are narrow. 0 would weigh a border, where registration errors show, like the middle.
  double taper_cells = 48.0;
  // Information (equivalent samples a cell) at which a scene's weight is half of what it can become: weight = n / (n + this). Larger
  // prefers the best seen scene; smaller comes nearer to one scene, one vote, which resists movers better.
  double half_information = 2.0;
  // Whether a scene that samples the ground more coarsely than the mosaic does, because it looked from farther away or more obliquely,
  // counts for less: in proportion to WarpedScene::detail, at most 1. Off: sharp and blurred views of the same ground count alike.
  bool weigh_detail = true;
  // A sample with less than half_information AND less than this part of the best sample's n / (n + half) counts as poor: it is used only
  // where nothing better covers the pixel.
  double poor_ratio = 0.5;
  MedianOptions median;
  // Bound on the resampled scenes held at once; the tile is made in bands of rows that respect it.
  std::uint64_t stack_bytes_max = std::uint64_t{256} << 20;
};

// Planes of one tile, all of its size. Pixels that nothing covers: median, nmad and position_sigma NaN, count 0, source kNoSource.
struct CompositeTile {
  Image<float> median;          // What the estimator makes of the samples: balanced internal grey levels.
  Image<float> count;           // Samples that took part.
  Image<float> nmad;            // Spread of the samples; NaN where fewer than 2 took part: one sample tells nothing about spread.
  Image<float> position_sigma;  // Standard error of position, CRS units: weighted root mean square over the samples, because the errors
                                // of scenes that were aligned together are alike and do not average out.
  Image<float> source;          // window_id of the sample with the largest weight.
};

inline constexpr float kNoSource = -1.0f;
// Window ids are kept in float32 planes, which hold integers exactly up to here.
inline constexpr std::uint32_t kWindowIdMax = 1u << 24;

// What one scene costs while it is resampled: a cell that was read (two bands, its distance to the border, a mask and its padding) and a
// pixel that was resampled before it goes onto the stack.
inline constexpr std::uint64_t kSceneCellBytes = 18;
inline constexpr std::uint64_t kWarpedPixelBytes = 16;
// What a pixel of the stack costs: value, weight and saturation.
inline constexpr std::uint64_t kStackSampleBytes = 12;

// Reads the cells `roi` of the raster of scene `index` (of the span given to ComposeTile); (0, 0) is the raster's first cell.
using SceneReader = std::function<Result<SceneRaster>(std::size_t index, const Roi& roi)>;

// Indices of the scenes whose footprint reaches `roi_in_mosaic`, ordered by (window_id, scene_id).
Result<std::vector<std::size_t>> ContributingScenes(const MosaicGrid& grid, const Roi& roi_in_mosaic,
                                                    std::span<const CompositeScene> scenes);

// For every tile of the grid the indices of the scenes whose footprint reaches it, rising. Cost: scenes + pairs.
Result<std::vector<std::vector<std::size_t>>> ScenesByTile(const MosaicGrid& grid, std::span<const CompositeScene> scenes);

// Resamples every scene that reaches the rectangle `roi_in_mosaic` of `grid` onto it, and reduces each pixel by options.median (see
// median.h). Weight of a sample: n / (n + half_information) times a smooth step over taper_cells from the scene's border times its
// detail. The result depends on the set of scenes only, not on their order, and any tiling of a mosaic gives the same pixels. `progress` is
// called with the fraction done; false cancels. Memory: about stack_bytes_max + the tile's planes (20 B a pixel) + one scene as read and
// warped (kSceneCellBytes a cell, kWarpedPixelBytes a pixel of a band).
Result<CompositeTile> ComposeTile(const MosaicGrid& grid, const Roi& roi_in_mosaic, std::span<const CompositeScene> scenes,
                                  const SceneReader& reader, const CompositeOptions& options, const std::function<bool(double)>& progress);

}  // namespace trem
