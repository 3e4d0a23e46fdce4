#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <vector>

#include "mosaic/base/artefact_store.h"
#include "mosaic/base/image.h"
#include "mosaic/base/status.h"
#include "mosaic/composite/tile_compositor.h"
#include "proto/trem/v1/task.pb.h"
#include "worker/simulate/records.h"

namespace trem::score {

// What `trem run --keep-work` left behind: the scenes and where the alignment put them.
struct KeptRun {
  ArtefactStore store;
  v1::SortieManifest manifest;
  std::vector<v1::WindowResult> windows;
  v1::Alignment alignment;
};

// `work`: the folder "<output>.work". kNotFound when it is no such folder, kInvalidInput when its job is not finished.
Result<KeptRun> ReadKeptRun(const std::filesystem::path& work);

// A scene of the run beside the truth.
struct ScenePlacement {
  CompositeScene aligned;
  ArtefactRef raster;
  Homography true_world_from_scene;  // From the true cameras of the frames that dominate it, least squares over the corners of their ROIs.
  Eigen::Vector2d error_m = Eigen::Vector2d::Zero();  // Of the scene's centre: aligned - true, map metres.
  // truth = true_gain * scene + true_offset by the true gains and offsets of those frames, grey levels of the truth.
  CellShifts true_shifts;  // Over hills: what the same frames show away from true_world_from_scene.
  double true_gain = 1.0;
  double true_offset = 0.0;
};

// All scenes of the alignment, in its order. kInvalidInput when the run is not georeferenced or not of this simulation.
Result<std::vector<ScenePlacement>> PlaceTruly(const KeptRun& run, const SimulationRecord& record);

// The run's mosaic once more with other scenes: weighted median on the run's own grid of what `change` makes of each scene.
Result<Image<float>> ComposeAgain(const KeptRun& run, const std::vector<ScenePlacement>& placements,
                                  const std::function<CompositeScene(const ScenePlacement&)>& change, const CompositeOptions& options);

}  // namespace trem::score
