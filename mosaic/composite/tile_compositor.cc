#include "mosaic/composite/tile_compositor.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <string>

#include "mosaic/composite/warp.h"
#include "mosaic/geometry/footprint.h"

namespace trem {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
// WarpedScene's three planes.
constexpr std::uint64_t kBytesPerSample = 3 * sizeof(float);
// Weight at the very border of a scene, so that ground that only borders cover is still covered.
constexpr double kTaperLeast = 1e-3;

std::string Name(const CompositeScene& scene) {
  return "scene " + std::to_string(scene.scene_id) + " of window " + std::to_string(scene.window_id);
}

// A scene with its maps to and from mosaic pixels.
struct PlacedScene {
  std::size_t index = 0;
  Homography scene_from_mosaic;
  Roi roi_in_mosaic;  // Of the tile; pixels that it may cover.
};

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
  placed.roi_in_mosaic = BoundingRoi(ProjectRoi(*mosaic_from_scene, raster), all).value_or(Roi{});
  return placed;
}

// Cells of the scene that the mosaic pixels of `roi` may need, relative to the raster; nullopt when none.
std::optional<Roi> NeededCells(const PlacedScene& placed, const CompositeScene& scene, const Roi& roi, int margin) {
  const Roi& raster = scene.raster_in_scene;
  std::optional<Roi> cells = BoundingRoi(ProjectRoi(placed.scene_from_mosaic, roi), raster);
  if (!cells) return std::nullopt;
  const Roi grown{cells->x0 - margin, cells->y0 - margin, cells->x1 + margin, cells->y1 + margin};
  const Roi clipped = Intersect(grown, raster);
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

double Taper(float border_distance, double taper_cells) {
  if (taper_cells <= 0.0) return 1.0;
  const double t = std::min(static_cast<double>(border_distance) / taper_cells, 1.0);
  return std::max(t * t * (3.0 - 2.0 * t), kTaperLeast);
}

// A warped scene in the stack; layers lie in the order (window_id, scene_id).
struct Layer {
  const CompositeScene* scene = nullptr;
  WarpedScene warped;
};

class PixelReducer {
 public:
  PixelReducer(const CompositeOptions& options, std::span<const Layer> layers) : options_(options), layers_(layers) {
    sigma2_.resize(layers.size());
    for (std::size_t i = 0; i < layers.size(); ++i) sigma2_[i] = layers[i].scene->position_sigma * layers[i].scene->position_sigma;
  }

  // Pixel (x, y) of the mosaic into pixel (column, row) of `tile`.
  void Reduce(int x, int y, int column, int row, CompositeTile* tile) {
    Collect(x, y);
    if (samples_.empty()) return;
    double weight_sum = 0.0, sigma2_sum = 0.0;
    for (std::size_t i = 0; i < samples_.size(); ++i) {
      weight_sum += samples_[i].weight;
      sigma2_sum += samples_[i].weight * sigma2_[samples_[i].source];
    }
    const PixelMedian pixel = ReducePixel(samples_, options_.median);
    tile->median.at(column, row) = pixel.median;
    tile->count.at(column, row) = static_cast<float>(pixel.count);
    tile->nmad.at(column, row) = pixel.count > 1 ? pixel.nmad : kNan;
    tile->position_sigma.at(column, row) = static_cast<float>(std::sqrt(sigma2_sum / weight_sum));
    tile->source.at(column, row) = static_cast<float>(layers_[pixel.source].scene->window_id);
  }

 private:
  // The samples that take part, in the layers' order; `source` is the layer's index.
  void Collect(int x, int y) {
    samples_.clear();
    saturation_.clear();
    double best = 0.0;
    for (std::size_t i = 0; i < layers_.size(); ++i) {
      const WarpedScene& warped = layers_[i].warped;
      if (!warped.roi_in_mosaic.Contains(x, y)) continue;
      const int wx = x - warped.roi_in_mosaic.x0, wy = y - warped.roi_in_mosaic.y0;
      const float intensity = warped.intensity.at(wx, wy);
      if (std::isnan(intensity)) continue;
      const double n = warped.information.at(wx, wy);
      const double saturation = n / (n + options_.half_information);
      const CompositeScene& scene = *layers_[i].scene;
      WeightedSample sample;
      sample.value = static_cast<float>(scene.gain * intensity + scene.offset);
      sample.weight = static_cast<float>(saturation * Taper(warped.border_distance.at(wx, wy), options_.taper_cells));
      sample.source = static_cast<std::uint32_t>(i);
      if (!(sample.weight > 0.0f) || !std::isfinite(sample.value)) continue;
      samples_.push_back(sample);
      saturation_.push_back(saturation);
      best = std::max(best, saturation);
    }
    std::size_t kept = 0;
    for (std::size_t i = 0; i < samples_.size(); ++i) {
      const bool poor = saturation_[i] < 0.5 && saturation_[i] < options_.poor_ratio * best;
      if (!poor) samples_[kept++] = samples_[i];
    }
    samples_.resize(kept);
  }

  const CompositeOptions& options_;
  std::span<const Layer> layers_;
  std::vector<double> sigma2_;
  std::vector<WeightedSample> samples_;
  std::vector<double> saturation_;
};

// Rows of the next band from `y0` so that its stack stays within the budget; at least one.
int BandRows(const std::vector<PlacedScene>& placed, const Roi& roi, int y0, std::uint64_t bytes_max) {
  std::uint64_t bytes = 0;
  int rows = 0;
  for (int y = y0; y < roi.y1; ++y) {
    for (const PlacedScene& scene : placed) {
      if (y >= scene.roi_in_mosaic.y0 && y < scene.roi_in_mosaic.y1) {
        bytes += static_cast<std::uint64_t>(scene.roi_in_mosaic.width()) * kBytesPerSample;
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
  return std::optional<WarpedScene>(WarpScene(*source, placed.scene_from_mosaic, roi));
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

Result<CompositeTile> ComposeTile(const MosaicGrid& grid, const Roi& roi_in_mosaic, std::span<const CompositeScene> scenes,
                                  const SceneReader& reader, const CompositeOptions& options, const std::function<bool(double)>& progress) {
  TREM_ASSIGN_OR_RETURN(const std::vector<PlacedScene> placed, PlaceContributing(grid, roi_in_mosaic, scenes));
  const int width = roi_in_mosaic.width();
  const int height = roi_in_mosaic.height();
  CompositeTile tile{Image<float>(width, height, kNan), Image<float>(width, height, 0.0f), Image<float>(width, height, kNan),
                     Image<float>(width, height, kNan), Image<float>(width, height, kNoSource)};
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
      if (warped) layers.push_back({&scene, std::move(*warped)});
    }
    PixelReducer reducer(options, layers);
    for (int y = band.y0; y < band.y1; ++y) {
      if ((y - band.y0) % 64 == 0 && !progress((y0 - roi_in_mosaic.y0 + 0.5 * (rows + y - y0)) / height)) {
        return Cancelled("compositing was stopped");
      }
      for (int x = band.x0; x < band.x1; ++x) reducer.Reduce(x, y, x - roi_in_mosaic.x0, y - roi_in_mosaic.y0, &tile);
    }
    y0 += rows;
  }
  return tile;
}

}  // namespace trem
