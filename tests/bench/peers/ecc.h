#pragma once

#include "worker/tre/mapping_engine.h"

namespace trem::bench {

struct EccAnswer {
  Affine previous_from_current;
  double seconds = 0.0;  // CPU time of the calling thread.
};

// When OpenCV's method stops, and its smoothing of both images (side of the Gaussian kernel; 1: none).
struct EccSettings {
  double eps = 1e-6;  // Of the correlation coefficient, from one iteration to the next.
  int iterations_max = 50;
  int smoothing_px = 5;  // OpenCV's default. Without, it is slower and less accurate on these frames.
};
// Runs until it no longer moves: its best accuracy on these frames.
inline constexpr EccSettings kConvergedEcc{};
// Ended when it is near: what speed is compared with.
inline constexpr EccSettings kHastyEcc{1e-3};

// One cv::findTransformECC call: `now` registered to `before`, affine, from the motion that the engine is told; that motion when the call
// gives up. Source: Evangelidis and Psarakis, IEEE Trans. PAMI 30(10), 2008.
EccAnswer RegisterEcc(const FrameInput& before, const FrameInput& now, const EccSettings& settings);

}  // namespace trem::bench
