#pragma once

#include <vector>

#include <span>

#include "mosaic/align/align_graph.h"
#include "mosaic/align/level_ties.h"
#include "mosaic/base/status.h"

namespace trem::align {

// value = gain * x + offset, internal grey levels.
struct GainOffset {
  double gain = 1.0;
  double offset = 0.0;
};

// What the sensor darkens (or brightens) by towards its corners, as a factor on its grey levels at r half diagonals from the image centre:
//
//   V(r) = 1 + second r^2 + fourth r^4
struct Vignetting {
  double second = 0.0;
  double fourth = 0.0;

  double At(const FieldPowers& field) const { return 1.0 + second * field.second + fourth * field.fourth; }
};

struct PhotometricBalance {
  std::vector<GainOffset> balanced_from_scene;  // Parallel to AlignGraph::scenes.
  std::vector<GainOffset> frame_from_balanced;  // Parallel to AlignGraph::frames.
  Vignetting vignetting;
};

// One gain and offset a scene and a frame, from the chain's frame = gain * scene + offset:
//
//   frame_t = G_t balanced + O_t,  scene_i = A_i balanced + B_i   =>   gain_ti = G_t / A_i,  offset_ti = O_t - gain_ti B_i
//
// and, of patches of ground that two scenes show, also of legs that share no frame (`level_ties`),
//
//   (level_a / V_a - B_a) / A_a = (level_b / V_b - B_b) / A_b,      V_i: the mean of V over where scene i's frames saw the patch
//
// Robust nonlinear least squares (log G, O, log A, B, V; Ceres), weighted by the chain's covariances. Gauge: frames are drawn to gain 1 and
// no change of a mid grey by priors too weak (20 %, 20 levels) to resist what the views say of each other.
Result<PhotometricBalance> Balance(const AlignGraph& graph, std::span<const LevelTie> level_ties);

// Factors that undo `vignetting` over a scene; empty when it is too faint to matter (0.4 % anywhere).
CellGrid<double> ShadeOf(const AlignGraph& graph, int scene, const Vignetting& vignetting);

}  // namespace trem::align
