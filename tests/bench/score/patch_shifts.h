#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "mosaic/base/image.h"
#include "tests/bench/score/rasters.h"

namespace trem::score {

struct PatchOptions {
  int patch_px = 168;    // Side of a patch, mosaic pixels; neighbours overlap by half.
  int radius_px = 18;    // Search around the starting shift.
  int margin_px = 0;     // By how much the truth image is larger than the mosaic on every side.
  double texture = 2.0;  // Least root mean square gradient of the truth in its weakest direction, grey levels a pixel.
};

// How far the mosaic's content stands from where the truth has it: mosaic position - true position, mosaic pixels (x right, y down).
struct PatchShift {
  Eigen::Vector2d centre_px = Eigen::Vector2d::Zero();
  Eigen::Vector2d shift_px = Eigen::Vector2d::Zero();
  bool matched = false;  // Correlation at least 0.6 and its peak inside the search range.
};

// Shifts of all patches that are valid throughout and in which the truth has texture in every direction. `truth` lies on the mosaic's
// grid, enlarged by options.margin_px on every side (Reference::OnGrid, without shift): a mosaic that stands off shows at its edge ground
// that lies outside its grid. Integer shift by normalised correlation, then Gauss-Newton on shift, gain and offset: exact to about 0.01 px
// on clean data. Precondition: margin_px >= |start_px| + radius_px along each axis.
std::vector<PatchShift> MeasurePatchShifts(const Image<float>& mosaic, const Image<float>& truth, const Eigen::Vector2d& start_px,
                                           const PatchOptions& options);

// The median shift of the matched patches, each axis on its own; nothing when fewer than `least` matched.
std::optional<Eigen::Vector2d> MedianShift(const std::vector<PatchShift>& shifts, int least);

// Quantile q in [0, 1] by linear interpolation between order statistics. Precondition: not empty.
double Quantile(std::vector<double> values, double q);

}  // namespace trem::score
