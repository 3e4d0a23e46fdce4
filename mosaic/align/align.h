#pragma once

#include <functional>
#include <string>
#include <vector>

#include "mosaic/align/align_graph.h"
#include "mosaic/align/content_ties.h"
#include "mosaic/align/control.h"
#include "mosaic/align/photometry.h"
#include "mosaic/base/status.h"
#include "mosaic/geometry/cell_grid.h"

namespace trem::align {

struct AlignedScene {
  std::uint32_t window_id = 0;
  std::uint32_t scene_id = 0;
  int piece = 0;
  Homography world_from_scene;  // Working world from cells of the segment's scene plane; positive Depth() on the scene.
  double position_sigma = 0.0;  // Standard error of the scene's centre, working units.
  CellShifts shifts;            // What relief adds to world_from_scene.
  CellGrid<double> shade;       // Factors on the scene's intensity, before gain and offset, that undo vignetting.
  GainOffset balanced_from_scene;
  Roi roi_in_scene;
};

struct AlignedFrame {
  std::uint32_t frame = 0;
  int piece = 0;
  Homography world_from_sensor;
  double residual_px = 0.0;  // Rms of its ties' residuals.
  GainOffset frame_from_balanced;
};

struct OutlierTie {
  std::uint32_t frame = 0;
  std::uint32_t window_id = 0;
  std::uint32_t scene_id = 0;
  double error_px = 0.0;  // Rms of the tie's coordinates.
};

// Scenes that seemed to show the same ground, and do not by all the others.
struct OutlierPair {
  std::uint32_t window_a = 0;
  std::uint32_t scene_a = 0;
  std::uint32_t window_b = 0;
  std::uint32_t scene_b = 0;
  double error_px = 0.0;
};

struct AlignSolution {
  std::vector<AlignedScene> scenes;  // Sorted by (window, scene).
  std::vector<AlignedFrame> frames;  // Every frame that any chain registered, used as an unknown or not; sorted.
  int piece_count = 0;
  bool georeferenced = false;
  std::string gauge;                          // What fixed the freedom that the data do not determine.
  std::vector<OutlierTie> outlier_ties;       // Sorted by (window, scene, frame).
  std::vector<std::uint32_t> horizon_frames;  // Frames some of whose ROIs reach the horizon and were left out there.
  std::vector<AlignedScene> unplaced_scenes;  // Georeferenced only: nothing connects them to a frame with telemetry.
  std::vector<AlignedScene> insane_scenes;    // Left out: area scale off by more than 8 from the median, or across the horizon.
  int used_frame_count = 0;
  int content_tie_count = 0;  // Pairs of scenes tied by what they show.
  int content_point_count = 0;
  int content_outlier_count = 0;
  std::vector<OutlierPair> outlier_pairs;
  ControlReport control;
  Lens lens;
  Vignetting vignetting;
  int level_tie_count = 0;  // Pairs of scenes whose brightness was compared on the ground.
  int join_count = 0;       // Pieces joined by content.
  double tie_rms_px = 0.0;
  double variance_factor = 1.0;
};

// Gives the features of scene `index` of `graph`, or nothing when the scene has too few; called once a
// scene, from up to AlignOptions::threads threads at once.
using FeatureSource = std::function<Result<SceneFeatures>(const AlignGraph& graph, int index)>;
// Called often with the fraction done; false cancels.
using AlignProgress = std::function<bool(double fraction)>;

// Places every scene and every frame: initial values, robust solve, then (when `features` is given) up to three rounds of ties by
// content between scenes that overlap but share no frame, and between pieces, each followed by another solve.
// Pieces without telemetry are laid out side by side, left to right, in the order of their first frames.
// kFailed when no scene can be placed.
Result<AlignSolution> Align(AlignInput input, const AlignOptions& options, const FeatureSource& features, const AlignProgress& progress);

}  // namespace trem::align
