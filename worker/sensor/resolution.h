#pragma once

#include <string>

#include "worker/sensor/psf.h"

namespace trem {

// The finest detail that can be in a scene, whatever the number of frames.
struct ResolutionCeiling {
  double cycles_per_px = 0.0;  // The smallest of the limits below, cycles a sensor pixel (0.5: a single frame's Nyquist).
  const char* limit = "";      // Which of them it is, in words.
  double optics_cutoff = 0.0;  // 1 / q; 0: not known.
  double detector_zero = 0.0;  // First zero of the detector's transfer function, 1 / fill_factor; of a measured kernel: where it falls below 2 %.
  double grid_nyquist = 0.0;   // ratio / 2.
};

// `q` = wavelength * f_number / pixel_pitch; 0: not known.
ResolutionCeiling FindResolutionCeiling(const PsfParameters& parameters, double q, int ratio);

}  // namespace trem
