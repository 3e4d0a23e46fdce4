#pragma once

#include "mosaic/base/image.h"

namespace trem {

// Read and photon noise in one unit of grey: sigma^2(I) = read_variance + shot * max(I, 0).
struct NoiseModel {
  double read_variance = 4.0;     // > 0.
  double shot = 0.0;              // Variance per grey level above black; 0: constant noise.
  double typical_variance = 4.0;  // Of a pixel of weight 1.

  double Variance(double level) const { return read_variance + shot * (level > 0.0 ? level : 0.0); }
};

// Relative inverse variance typical_variance / sigma^2(I) of each pixel of `frame` [the model's grey levels]; 0 where it is NaN.
//
// I is the mean of the 5 x 5 pixels about each pixel WITHOUT itself: a weight that depends on the pixel's own noise prefers the dark
// side of it and biases what is averaged by -shot grey levels, and 1/25 of that when the pixel is one of the 25.
Image<float> NoiseWeights(const Image<float>& frame, const NoiseModel& model);

}  // namespace trem
