#pragma once

#include <vector>

#include "mosaic/base/status.h"

namespace trem {

// A symmetric separable point spread function on the scene grid: h(x, y) = taps[|x|] * taps[|y|], x, y in cells.
// taps[0] is the centre; 2 * sum(taps[1..]) + taps[0] == 1 exactly to float rounding.
struct SeparablePsf {
  std::vector<float> taps;
  int radius() const { return static_cast<int>(taps.size()) - 1; }
};

// What is known of the sensor, in sensor pixels.
struct PsfParameters {
  double sigma_px = 0.55;    // Gaussian part (optics, residual motion). 0.05 .. 3.
  double fill_factor = 0.9;  // Side of the detector's box, (0, 1].
};

// The PSF of a sensor on a grid `ratio` times finer: a Gaussian of sigma_px * ratio cells convolved with the detector's box of
// fill_factor * ratio cells, in closed form (difference of error functions) at the cell centres, truncated where less than 1e-3 of its
// mass remains and normalised. Point samples of the continuous PSF are exact for a scene that is band-limited on its grid, and the cubic
// sampling that follows reproduces quadratics, so neither widens the response to second order.
Result<SeparablePsf> MakePsf(const PsfParameters& parameters, int ratio);

}  // namespace trem
