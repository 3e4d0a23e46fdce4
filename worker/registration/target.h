#pragma once

#include "mosaic/base/image.h"
#include "mosaic/geometry/roi.h"

namespace trem {

// What a frame is registered against: the enhanced scene's prediction on the scene grid.
struct Reference {
  const Image<float>* prediction = nullptr;  // B S: the scene as the sensor would blur it, internal grey levels.
  const Image<float>* seen = nullptr;        // Frames that have seen each cell (0: never; filled in, not to be registered to).
  int x0 = 0;                                // Scene plane coordinates [cells] of the images' first pixel.
  int y0 = 0;
  int ratio = 3;                             // Cells per sensor pixel.
  // Cells seen by fewer frames than this are left out: they hold values continued from a ROI's border, or one frame's noise and aliasing
  // that the prior has not sorted out yet, and registering to them pulls towards no motion.
  float seen_min = 0.75F;
};

// What is registered: the ROI of one frame.
struct Observation {
  const Image<float>* roi_pixels = nullptr;  // roi.width() x roi.height(), internal grey levels. NaN: no measurement.
  Roi roi;                                   // In the sensor.
  double noise_sigma = 2.0;                  // Internal grey levels, of a pixel of weight 1.
  // Relative inverse variance of each pixel, same size as roi_pixels: noise_sigma^2 / sigma^2(u). 0: not to be used. Null: all 1.
  const Image<float>* weights = nullptr;

  float weight(int u, int v) const { return weights != nullptr ? weights->at(u, v) : 1.0F; }
};

}  // namespace trem
