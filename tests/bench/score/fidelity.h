#pragma once

#include "mosaic/base/image.h"

namespace trem::score {

// Agreement with the truth after one gain and offset.
struct Fidelity {
  double psnr_db = 0.0;  // Peak 255.
  double ssim = 0.0;     // Gaussian window, sigma 1.5 (Wang et al. 2004), at the mosaic's resolution.
};

// Brings `image` as close to `truth` as one gain and offset can, on the pixels where both are finite, and compares the two there.
Fidelity FitAndCompare(const Image<float>& truth, Image<float>* image);

}  // namespace trem::score
