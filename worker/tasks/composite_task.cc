// COMPOSITE: the scenes that reach one tile of the mosaic -> tile.tif.
#include <algorithm>
#include <filesystem>
#include <opencv2/core.hpp>
#include <set>
#include <string>
#include <vector>

#include "mosaic/composite/cutline.h"
#include "mosaic/composite/tile_compositor.h"
#include "mosaic/raster/scene_raster.h"
#include "proto/codec/convert.h"
#include "worker/tasks/aligned_scenes.h"
#include "worker/tasks/cutline_message.h"
#include "worker/tasks/task.h"
#include "worker/tasks/task_inputs.h"
#include "worker/tasks/tile_raster.h"

namespace trem {
namespace {

// Cells read of one scene at once; with its distances and mask 13 bytes each: 208 MiB.
constexpr long long kSceneCellsMax = 1LL << 24;
// Width of a scene's fade-in at its border, sensor pixels.
constexpr double kTaperPx = 16.0;
constexpr std::uint32_t kDefaultRatio = 3;

Estimator EstimatorOf(v1::MosaicEstimator estimator) {
  switch (estimator) {
    case v1::MEDIAN:
      return Estimator::kMedian;
    case v1::BIWEIGHT:
      return Estimator::kBiweight;
    default:
      return Estimator::kWeightedMedian;
  }
}

// Leaves in `alignment` the scenes of the windows that the task was given: the others do not reach its tile.
void KeepScenesOf(const std::set<std::uint32_t>& window_ids, v1::Alignment* alignment) {
  auto* scenes = alignment->mutable_scenes();
  scenes->erase(std::remove_if(scenes->begin(), scenes->end(),
                               [&](const v1::AlignedScene& scene) { return window_ids.count(scene.window_id()) == 0; }),
                scenes->end());
}

// Paths of the rasters of the scenes that reach the tile, each verified against its digest; the others stay empty.
Result<std::vector<std::filesystem::path>> LocateContributing(const ArtefactStore& store, const std::vector<ArtefactRef>& rasters,
                                                              const std::vector<std::size_t>& contributing) {
  std::vector<std::filesystem::path> paths(rasters.size());
  for (const std::size_t index : contributing) {
    TREM_RETURN_IF_ERROR(store.Verify(rasters[index]));
    TREM_ASSIGN_OR_RETURN(paths[index], store.Locate(rasters[index]));
  }
  return paths;
}

Result<MosaicGrid> TileGrid(const v1::TaskSpec& spec, const v1::Alignment& alignment) {
  TREM_ASSIGN_OR_RETURN(const MosaicGrid grid, FromProto(alignment.grid()));
  if (spec.composite().tile_index() >= static_cast<std::uint32_t>(grid.tile_count())) {
    return InvalidInput("tile " + std::to_string(spec.composite().tile_index()) + " of a mosaic of " + std::to_string(grid.tile_count()) +
                        " tiles was asked for");
  }
  if (grid.tile_size > kTileSideMax) {
    return InvalidInput("mosaic.tile_px is " + std::to_string(grid.tile_size) + "; expected at most " + std::to_string(kTileSideMax) +
                        ": larger tiles do not fit a worker's memory");
  }
  return grid;
}

}  // namespace

Result<v1::TaskResult> RunCompositeTask(const v1::TaskSpec& spec, const TaskContext& context) {
  cv::setNumThreads(1);
  v1::Alignment alignment;
  TREM_ASSIGN_OR_RETURN(const v1::ArtefactRef alignment_ref, SingleInput(spec, "alignment.pb"));
  TREM_RETURN_IF_ERROR(ReadProtoArtefact(*context.store, alignment_ref, &alignment));
  TREM_ASSIGN_OR_RETURN(const MosaicGrid grid, TileGrid(spec, alignment));
  const int tile_index = static_cast<int>(spec.composite().tile_index());
  const Roi roi = grid.TileRoi(tile_index);

  EmittedScenes emitted;
  std::set<std::uint32_t> window_ids;
  for (const v1::ArtefactRef& ref : InputsNamed(spec, "window.pb")) {
    if (!context.progress(0.0)) return Cancelled("compositing was stopped");
    v1::WindowResult window;
    TREM_RETURN_IF_ERROR(ReadProtoArtefact(*context.store, ref, &window));
    TREM_RETURN_IF_ERROR(AddEmittedScenes(window, &emitted));
    window_ids.insert(window.window_id());
  }
  KeepScenesOf(window_ids, &alignment);
  std::vector<ArtefactRef> rasters;
  TREM_ASSIGN_OR_RETURN(const std::vector<CompositeScene> scenes, PlacedScenes(alignment, emitted, &rasters));
  emitted.clear();
  TREM_ASSIGN_OR_RETURN(const std::vector<std::size_t> contributing, ContributingScenes(grid, roi, scenes));
  TREM_ASSIGN_OR_RETURN(const std::vector<std::filesystem::path> paths, LocateContributing(*context.store, rasters, contributing));

  CompositeOptions options;
  options.taper_cells = kTaperPx * (spec.sortie().tre().ratio() > 0 ? spec.sortie().tre().ratio() : kDefaultRatio);
  options.median.estimator = EstimatorOf(spec.sortie().mosaic().estimator());
  const SceneReader reader = [&](std::size_t index, const Roi& cells) { return ReadSceneRaster(paths[index], kSceneCellsMax, cells); };
  Result<CompositeTile> tile = ComposeTile(grid, roi, scenes, reader, options, context.progress);
  if (!tile.ok()) return tile.status().WithPrefix("tile " + std::to_string(tile_index));

  ApplyCutline(grid, roi, PolygonsFromProto(alignment.cutline()).rings, &*tile);

  const std::filesystem::path path = context.store->NewTemporaryPath(".tif");
  TREM_RETURN_IF_ERROR(WriteTileRaster(path, grid, tile_index, std::move(*tile)));
  TREM_ASSIGN_OR_RETURN(const ArtefactRef ref, context.store->PutFile("tile.tif", path));
  v1::TaskResult result;
  *result.add_outputs() = ToProto(ref);
  return result;
}

}  // namespace trem
