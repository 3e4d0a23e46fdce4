#pragma once

#include <span>
#include <vector>

#include "mosaic/align/align_state.h"
#include "mosaic/base/image.h"
#include "mosaic/geometry/cell_grid.h"

namespace trem::align {

// How bright a scene is, place by place: means of blocks of cells, at their centres; NaN where the scene was not seen.
using SceneLevels = CellGrid<double>;

// `intensity` and `information` as for ExtractFeatures. Blocks are about 3 sensor pixels a side. Empty for a scene smaller than two blocks.
SceneLevels MeanLevels(const Image<float>& intensity, const Image<float>& information, const Roi& roi_in_scene, int ratio);

// Means over squared and fourth powers of the distance from the image centre, in half diagonals, at which a scene's frames saw a place.
struct FieldPowers {
  double second = 0.0;
  double fourth = 0.0;
};
FieldPowers FieldPowersAt(const AlignGraph& graph, int scene, const Eigen::Vector2d& shown);

// One patch of ground of about 9 sensor pixels a side in two scenes.
struct LevelPair {
  double level_a = 0.0;
  double level_b = 0.0;
  FieldPowers field_a;
  FieldPowers field_b;
};

// Patches that two scenes have in common on the ground, whether they share frames or not.
struct LevelTie {
  int scene_a = 0;  // Index into AlignGraph::scenes.
  int scene_b = 0;
  std::vector<LevelPair> pairs;
};

// Scenes of one piece that overlap in the solved state; `levels` is parallel to AlignGraph::scenes (empty: takes no part). Deterministic,
// whatever the number of threads.
std::vector<LevelTie> FindLevelTies(const AlignGraph& graph, const AlignState& state, std::span<const SceneLevels> levels, int threads = 1);

}  // namespace trem::align
