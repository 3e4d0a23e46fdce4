#pragma once

#include <functional>
#include <span>
#include <vector>

#include "mosaic/align/align_state.h"
#include "mosaic/base/status.h"

namespace trem::align {

struct SolveReport {
  // How much larger the ties' squared residuals are than their covariances promise (median based; at least 1). Everything is
  // weighted by it in the last pass, so that sigmas are honest where relief or drift exceed the floor.
  double variance_factor = 1.0;
  double tie_rms_px = 0.0;             // Robust rms of one coordinate of a tie's residuals, sensor px.
  std::vector<double> tie_norm2;       // Squared whitened residual of each tie / variance_factor; expectation <= 8. -1: unused.
  std::vector<double> tie_error2_px2;  // Mean squared residual of each tie's coordinates, px^2. -1: unused.
  std::vector<double> scene_sigma;     // Standard error of each scene's centre, working world units: sqrt of the larger eigenvalue.
  int content_point_count = 0;
  int content_outlier_count = 0;  // Points further than 4 sigma.
  std::vector<double> content_error_px;   // Rms distance of each content tie's points, sensor px; of unused ones 0.
  std::vector<bool> content_tie_outlier;  // Most of the tie's points are further than 4 sigma.
  std::vector<double> control_norm2;  // Squared whitened residual of each control observation; -1: no constraint.
  bool converged = false;
};

// Improves `state` by robust least squares: Ceres, sparse normal equations, one thread (the same bytes on every run). Two passes: Huber,
// then Cauchy with the variance factor of the first. `with_sigma`: compute scene_sigma (the inverse of the normal matrix; for at most
// 500 scenes, spread evenly; the others take the value of the nearest computed one in order). `progress` is called every iteration;
// false cancels. kFailed when the equations can't be evaluated at the start.
Result<SolveReport> Solve(const AlignGraph& graph, std::span<const ContentTie> content_ties, const AlignOptions& options, bool with_sigma,
                          const std::function<bool()>& progress, AlignState& state);

}  // namespace trem::align
