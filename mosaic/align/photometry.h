#pragma once

#include <vector>

#include "mosaic/align/align_graph.h"
#include "mosaic/base/status.h"

namespace trem::align {

// value = gain * x + offset, internal grey levels.
struct GainOffset {
  double gain = 1.0;
  double offset = 0.0;
};

struct PhotometricBalance {
  std::vector<GainOffset> balanced_from_scene;  // Parallel to AlignGraph::scenes.
  std::vector<GainOffset> frame_from_balanced;  // Parallel to AlignGraph::frames.
};

// One gain and offset a scene and a frame, from the chain's frame = gain * scene + offset:
//
//   frame_t = G_t balanced + O_t,  scene_i = A_i balanced + B_i   =>   gain_ti = G_t / A_i,  offset_ti = O_t - gain_ti B_i
//
// Robust nonlinear least squares (log G, O, log A, B; Ceres), weighted by the chain's covariances. Gauge: frames are drawn to gain 1 and
// no change of a mid grey by priors too weak (20 %, 20 levels) to resist what the views say of each other.
Result<PhotometricBalance> Balance(const AlignGraph& graph);

}  // namespace trem::align
