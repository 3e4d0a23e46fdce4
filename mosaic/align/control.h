#pragma once

#include <string>
#include <vector>

#include "mosaic/align/align_state.h"
#include "mosaic/align/solver.h"

namespace trem::align {

// An observation of a ground control point after the solve.
struct AlignedControl {
  std::string name;
  std::uint32_t frame = 0;
  bool held_out = false;
  bool outlier = false;  // A constraint: it contradicts the others. Held out: further off than the standard errors explain.
  // Where the frame puts the observed pixel - the surveyed place, working world, metres, horizontal.
  Eigen::Vector2d error_m = Eigen::Vector2d::Zero();
};

// How well a set of control points is met. A point's error is the mean of its observations'.
struct ControlFit {
  int point_count = 0;
  double rmse_m = 0.0;  // Of the horizontal distance.
  double ce90_m = 0.0;  // Radius that holds 90 % of the points: their quantile from ten points on, 1.5175 rmse (circular normal) below.
};

struct ControlReport {
  std::vector<AlignedControl> observations;  // In AlignInput::control's order, without those that no placed frame shows.
  ControlFit constraints;                    // Outliers left out.
  ControlFit checks;                         // Held out points, all of them.
  std::vector<std::string> unseen;           // Points none of whose frames is placed; sorted.
};

// `report` comes from a Solve with sigmas.
ControlReport CheckControl(const AlignGraph& graph, const AlignState& state, const SolveReport& report);

}  // namespace trem::align
