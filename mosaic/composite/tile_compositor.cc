#include "mosaic/composite/tile_compositor.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <string>

#include "mosaic/composite/reduce_row.h"
#include "mosaic/composite/warp.h"
#include "mosaic/geometry/footprint.h"

namespace trem {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
// Weight at the very border of a scene, so that ground that only borders cover is still covered.
constexpr float kTaperLeast = 1e-3f;

std::string Name(const CompositeScene& scene) {
  return "scene " + std::to_string(scene.scene_id) + " of window " + std::to_string(scene.window_id);
}

// A scene with its maps to and from mosaic pixels.
struct PlacedScene {
  std::size_t index = 0;
  Homography scene_from_mosaic;
  Roi roi_in_mosaic;  // Of the tile; pixels that it may cover.
  int shift_cells = 0;  // What relief shifts at most.
};

Roi Grown(const Roi& roi, int margin) { return {roi.x0 - margin, roi.y0 - margin, roi.x1 + margin, roi.y1 + margin}; }

Result<PlacedScene> Place(const MosaicGrid& grid, const CompositeScene& scene, std::size_t index) {
  if (scene.raster_in_scene.empty()) return Corrupt(Name(scene) + " has no cells");
  if (scene.window_id > kWindowIdMax) return Corrupt(Name(scene) + ": window ids go up to " + std::to_string(kWindowIdMax));
  Homography pixel_from_world;
  pixel_from_world.matrix << 1.0 / grid.gsd, 0.0, -grid.origin_x / grid.gsd, 0.0, -1.0 / grid.gsd, grid.origin_y / grid.gsd, 0.0, 0.0, 1.0;
  const Roi& raster = scene.raster_in_scene;
  const Eigen::Vector2d centre(0.5 * (raster.x0 + raster.x1 - 1), 0.5 * (raster.y0 + raster.y1 - 1));
  const Result<Homography> mosaic_from_scene = NormalisedAt(pixel_from_world * scene.world_from_scene, centre);
  if (!mosaic_from_scene.ok()) return Corrupt(Name(scene) + ": world_from_scene: " + mosaic_from_scene.status().message());
  PlacedScene placed;
  placed.index = index;
  placed.scene_from_mosaic = mosaic_from_scene->Inverse();
  if (!placed.scene_from_mosaic.matrix.allFinite()) return Corrupt(Name(scene) + ": world_from_scene is singular");
  const Roi all{0, 0, grid.width, grid.height};
  placed.shift_cells = static_cast<int>(std::ceil(LargestShift(scene.shifts)));
  placed.roi_in_mosaic = BoundingRoi(ProjectRoi(*mosaic_from_scene, Grown(raster, placed.shift_cells)), all).value_or(Roi{});
  return placed;
}

// Cells of the scene that the mosaic pixels of `roi` may need, relative to the raster; nullopt when none.
std::optional<Roi> NeededCells(const PlacedScene& placed, const CompositeScene& scene, const Roi& roi, int margin) {
  const Roi& raster = scene.raster_in_scene;
  const int shift = placed.shift_cells;
  const std::optional<Roi> level = BoundingRoi(ProjectRoi(placed.scene_from_mosaic, roi), Grown(raster, shift));
  if (!level) return std::nullopt;
  const Roi cells = Intersect(Grown(*level, shift), raster);
  if (cells.empty()) return std::nullopt;
  const Roi clipped = Intersect(Grown(cells, margin), raster);
  return Roi{clipped.x0 - raster.x0, clipped.y0 - raster.y0, clipped.x1 - raster.x0, clipped.y1 - raster.y0};
}

Result<std::vector<PlacedScene>> PlaceContributing(const MosaicGrid& grid, const Roi& roi, std::span<const CompositeScene> scenes) {
  std::vector<PlacedScene> contributing;
  for (std::size_t i = 0; i < scenes.size(); ++i) {
    TREM_ASSIGN_OR_RETURN(PlacedScene placed, Place(grid, scenes[i], i));
    placed.roi_in_mosaic = Intersect(placed.roi_in_mosaic, roi);
    if (placed.roi_in_mosaic.empty() || !NeededCells(placed, scenes[i], placed.roi_in_mosaic, 0)) continue;
    contributing.push_back(placed);
  }
  std::sort(contributing.begin(), contributing.end(), [&](const PlacedScene& a, const PlacedScene& b) {
    const CompositeScene& sa = scenes[a.index];
    const CompositeScene& sb = scenes[b.index];
    return std::pair(sa.window_id, sa.scene_id) < std::pair(sb.window_id, sb.scene_id);
  });
  for (std::size_t i = 1; i < contributing.size(); ++i) {
    const CompositeScene& a = scenes[contributing[i - 1].index];
    const CompositeScene& b = scenes[contributing[i].index];
    if (a.window_id == b.window_id && a.scene_id == b.scene_id) return Corrupt(Name(b) + " is listed twice");
  }
  return contributing;
}

float Taper(float border_distance, float taper_cells) {
  if (!(taper_cells > 0.0f)) return 1.0f;
  const float t = std::min(border_distance / taper_cells, 1.0f);
  return std::max(t * t * (3.0f - 2.0f * t), kTaperLeast);
}

// A resampled scene in the stack: what its pixels say and how much that counts. Layers lie in the order (window_id, scene_id).
struct Layer {
  const CompositeScene* scene = nullptr;
  Roi roi_in_mosaic;
  Image<float> value;   // Balanced; finite.
  Image<float> weight;  // 0 where the scene says nothing.
  Image<float> saturation;
};

Layer MakeLayer(const CompositeScene& scene, WarpedScene warped, const CompositeOptions& options) {
  Layer layer;
  layer.scene = &scene;
  layer.roi_in_mosaic = warped.roi_in_mosaic;
  const auto gain = static_cast<float>(scene.gain), offset = static_cast<float>(scene.offset);
  const auto half = static_cast<float>(options.half_information), taper = static_cast<float>(options.taper_cells);
  // In place: `information` becomes the saturation, the distance the weight.
  for (std::size_t i = 0; i < warped.intensity.pixels().size(); ++i) {
    float& value = warped.intensity.pixels()[i];
    float& saturation = warped.information.pixels()[i];
    float& weight = warped.border_distance.pixels()[i];
    value = gain * value + offset;
    saturation = saturation / (saturation + half);
    weight = saturation * Taper(weight, taper);
    if (options.weigh_detail) weight *= std::min(warped.detail.pixels()[i], 1.0f);
    if (std::isfinite(value) && weight > 0.0f) {
      value += 0.0f;  // No negative zero, which would tie with the other one.
    } else {
      value = weight = saturation = 0.0f;
    }
  }
  layer.value = std::move(warped.intensity);
  layer.weight = std::move(warped.border_distance);
  layer.saturation = std::move(warped.information);
  return layer;
}

// Row `y` of the mosaic into row `row` of `tile`, whose first column is `x0`.
void ReduceTileRow(std::span<const Layer> layers, int x0, int y, int row, const ReduceOptions& options, std::vector<SampleRow>* samples,
                   CompositeTile* tile) {
  samples->clear();
  for (const Layer& layer : layers) {
    const Roi& roi = layer.roi_in_mosaic;
    if (y < roi.y0 || y >= roi.y1) continue;
    SampleRow sample;
    sample.begin = roi.x0 - x0;
    sample.end = roi.x1 - x0;
    sample.value = layer.value.row(y - roi.y0);
    sample.weight = layer.weight.row(y - roi.y0);
    sample.saturation = layer.saturation.row(y - roi.y0);
    sample.sigma2 = static_cast<float>(layer.scene->position_sigma * layer.scene->position_sigma);
    sample.source = static_cast<float>(layer.scene->window_id);
    samples->push_back(sample);
  }
  ReduceRow(*samples, tile->median.width(), options,
            {tile->median.row(row), tile->count.row(row), tile->nmad.row(row), tile->position_sigma.row(row), tile->source.row(row)});
}

// Rows of the next band from `y0` so that its stack stays within the budget; at least one.
int BandRows(const std::vector<PlacedScene>& placed, const Roi& roi, int y0, std::uint64_t bytes_max) {
  std::uint64_t bytes = 0;
  int rows = 0;
  for (int y = y0; y < roi.y1; ++y) {
    for (const PlacedScene& scene : placed) {
      if (y >= scene.roi_in_mosaic.y0 && y < scene.roi_in_mosaic.y1) {
        bytes += static_cast<std::uint64_t>(scene.roi_in_mosaic.width()) * kStackSampleBytes;
      }
    }
    if (bytes > bytes_max && rows > 0) break;
    ++rows;
  }
  return rows;
}

Result<std::optional<WarpedScene>> WarpOnto(const PlacedScene& placed, const CompositeScene& scene, const Roi& band,
                                            const SceneReader& reader, const CompositeOptions& options) {
  const Roi roi = Intersect(placed.roi_in_mosaic, band);
  if (roi.empty()) return std::optional<WarpedScene>();
  const std::optional<Roi> cells = NeededCells(placed, scene, roi, WarpMarginCells(options.taper_cells));
  if (!cells) return std::optional<WarpedScene>();
  TREM_ASSIGN_OR_RETURN(SceneRaster raster, reader(placed.index, *cells));
  Result<WarpSource> source = PrepareWarp(std::move(raster), scene.raster_in_scene);
  if (!source.ok()) return source.status().WithPrefix(Name(scene));
  return std::optional<WarpedScene>(WarpScene(*source, {placed.scene_from_mosaic, scene.shifts, scene.shade}, roi));
}

}  // namespace

Result<std::vector<std::size_t>> ContributingScenes(const MosaicGrid& grid, const Roi& roi_in_mosaic,
                                                    std::span<const CompositeScene> scenes) {
  TREM_ASSIGN_OR_RETURN(const std::vector<PlacedScene> placed, PlaceContributing(grid, roi_in_mosaic, scenes));
  std::vector<std::size_t> indices;
  indices.reserve(placed.size());
  for (const PlacedScene& scene : placed) indices.push_back(scene.index);
  return indices;
}

Result<std::vector<std::vector<std::size_t>>> ScenesByTile(const MosaicGrid& grid, std::span<const CompositeScene> scenes) {
  std::vector<std::vector<std::size_t>> tiles(static_cast<std::size_t>(grid.tile_count()));
  for (std::size_t i = 0; i < scenes.size(); ++i) {
    TREM_ASSIGN_OR_RETURN(const PlacedScene placed, Place(grid, scenes[i], i));
    const Roi& roi = placed.roi_in_mosaic;
    if (roi.empty()) continue;
    for (int row = roi.y0 / grid.tile_size; row * grid.tile_size < roi.y1; ++row) {
      for (int column = roi.x0 / grid.tile_size; column * grid.tile_size < roi.x1; ++column) {
        const int tile = row * grid.tile_columns() + column;
        if (NeededCells(placed, scenes[i], Intersect(roi, grid.TileRoi(tile)), 0)) tiles[static_cast<std::size_t>(tile)].push_back(i);
      }
    }
  }
  return tiles;
}

Result<CompositeTile> ComposeTile(const MosaicGrid& grid, const Roi& roi_in_mosaic, std::span<const CompositeScene> scenes,
                                  const SceneReader& reader, const CompositeOptions& options, const std::function<bool(double)>& progress) {
  TREM_ASSIGN_OR_RETURN(const std::vector<PlacedScene> placed, PlaceContributing(grid, roi_in_mosaic, scenes));
  const int width = roi_in_mosaic.width();
  const int height = roi_in_mosaic.height();
  CompositeTile tile{Image<float>(width, height, kNan), Image<float>(width, height, 0.0f), Image<float>(width, height, kNan),
                     Image<float>(width, height, kNan), Image<float>(width, height, kNoSource)};
  const ReduceOptions reduce{options.median, static_cast<float>(options.poor_ratio), kNoSource};
  std::vector<SampleRow> samples;
  for (int y0 = roi_in_mosaic.y0; y0 < roi_in_mosaic.y1;) {
    const int rows = BandRows(placed, roi_in_mosaic, y0, options.stack_bytes_max);
    const Roi band{roi_in_mosaic.x0, y0, roi_in_mosaic.x1, y0 + rows};
    std::vector<Layer> layers;
    for (std::size_t i = 0; i < placed.size(); ++i) {
      // Resampling counts as half of a band's work.
      const double done = (y0 - roi_in_mosaic.y0 + 0.5 * rows * static_cast<double>(i) / static_cast<double>(placed.size())) / height;
      if (!progress(done)) return Cancelled("compositing was stopped");
      const CompositeScene& scene = scenes[placed[i].index];
      TREM_ASSIGN_OR_RETURN(std::optional<WarpedScene> warped, WarpOnto(placed[i], scene, band, reader, options));
      if (warped) layers.push_back(MakeLayer(scene, std::move(*warped), options));
    }
    for (int y = band.y0; y < band.y1; ++y) {
      if ((y - band.y0) % 64 == 0 && !progress((y0 - roi_in_mosaic.y0 + 0.5 * (rows + y - y0)) / height)) {
        return Cancelled("compositing was stopped");
      }
      ReduceTileRow(layers, roi_in_mosaic.x0, y, y - roi_in_mosaic.y0, reduce, &samples, &tile);
    }
    y0 += rows;
  }
  return tile;
}

}  // namespace trem
