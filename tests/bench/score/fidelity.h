#pragma once

#include "mosaic/base/image.h"

namespace trem::score {

// Agreement with the truth after one gain and offset.
struct Fidelity {
  double psnr_db = 0.0;  // Peak 255.
  double ssim = 0.0;     // Gaussian window, sigma 1.5 (Wang et al. 2004), at the mosaic's resolution.
};

// Brings `image` as close to `truth` as one gain and offset can, on the pixels where both are finite, and compares the two there.
// Whether neighbouring places of an image are equally bright beside the truth: over blocks of `block_px` pixels a side the mean error
// (image - truth, after FitAndCompare).
struct Evenness {
  double level_rms = 0.0;  // Rms of the blocks' mean errors, grey levels of the truth.
  double step_p95 = 0.0;   // 95 % of the absolute differences between neighbouring blocks: what a seam would show as.
};
Evenness MeasureEvenness(const Image<float>& truth, const Image<float>& image, int block_px);

Fidelity FitAndCompare(const Image<float>& truth, Image<float>* image);

}  // namespace trem::score
