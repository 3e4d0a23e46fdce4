#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "mosaic/align/align_state.h"
#include "mosaic/base/image.h"
#include "mosaic/geometry/cell_grid.h"

namespace trem::align {

// SIFT features of one scene (Lowe, IJCV 2004), found at about sensor resolution.
struct SceneFeatures {
  std::vector<Eigen::Vector2d> x_in_scene;  // Cells of the segment's scene plane.
  std::vector<std::uint8_t> descriptors;    // 128 numbers a feature.
  CellGrid<double> levels;                  // MeanLevels of the scene, for the photometric balance; empty: it takes no part.
};

struct ContentOptions {
  int features_max = 500;             // A scene; the strongest.
  double descriptor_ratio_max = 0.8;  // Lowe's ratio test.
  double inlier_px = 2.0;             // Sensor px; relief and perspective leave more than noise does.
  int inliers_min = 25;
  double inlier_fraction_min = 0.35;
  int points_max = 16;              // Points kept a tie, spread evenly.
  double overlap_min = 0.4;         // Of the smaller scene.
  int partners_max = 6;             // Pairs tried a scene and round.
  bool may_share_frames = false;    // Pairs that share frames are of use, too.
  int scenes_max = 600;             // Scenes that take part, spread evenly.
  int cross_piece_pairs_max = 400;  // Pairs tried between pieces whose relation is unknown.
};

// `intensity` and `information` have the size of `roi_in_scene`; cells with information 0 or without a finite intensity are masked.
// The scene is reduced by `ratio`. Deterministic.
SceneFeatures ExtractFeatures(const Image<float>& intensity, const Image<float>& information, const Roi& roi_in_scene, int ratio,
                              const ContentOptions& options);

// Points that both scenes show, when there are enough that agree with one affine map of credible scale (area ratio 1/4..4). `ratio`:
// cells per sensor pixel. RANSAC with a fixed seed.
std::optional<ContentTie> MatchFeatures(int scene_a, const SceneFeatures& a, int scene_b, const SceneFeatures& b, int ratio,
                                        const ContentOptions& options);

// Pairs (a < b) worth trying: scenes of one piece, or of pieces that telemetry places, that overlap in the current state and share no
// frame, the nearest in time and others spread over the rest; and between pieces of unknown relation, scenes spread evenly.
// `takes_part[s]`: scene s has features.
std::vector<std::pair<int, int>> CandidatePairs(const AlignGraph& graph, const AlignState& state, const std::vector<bool>& takes_part,
                                                const ContentOptions& options);

}  // namespace trem::align
