#pragma once

#include <Eigen/Core>
#include <vector>

#include "mosaic/base/status.h"
#include "worker/simulate/options.h"

namespace trem {

// Boxes in map metres (easting, northing).
struct AimLimits {
  Eigen::Vector2d truth_low_m = Eigen::Vector2d::Zero();
  Eigen::Vector2d truth_high_m = Eigen::Vector2d::Zero();
  // All that any frame needs, relative to the point it is aimed at.
  Eigen::Vector2d footprint_low_m = Eigen::Vector2d::Zero();
  Eigen::Vector2d footprint_high_m = Eigen::Vector2d::Zero();
};

struct AimPath {
  std::vector<Eigen::Vector2d> aim_m;  // One point a frame, map metres.
  double speed_px = 0.0;               // Distance of neighbouring points / gsd.
};

// Lays the points that the frames are aimed at so that everything they need stays inside the truth. kInvalidInput when it cannot be done;
// the message gives the numbers and the options to change.
Result<AimPath> PlanAimPath(const SimulationOptions& options, const AimLimits& limits);

}  // namespace trem
