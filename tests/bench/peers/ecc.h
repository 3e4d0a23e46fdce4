#pragma once

#include "worker/tre/mapping_engine.h"

namespace trem::bench {

struct EccAnswer {
  Affine previous_from_current;
  double seconds = 0.0;
};

// One cv::findTransformECC call: `now` registered to `before`, affine, from the motion that the engine is told, at most 50 iterations,
// eps 1e-3, OpenCV's default smoothing (Gaussian of 5 px). Source: Evangelidis and Psarakis, IEEE Trans. PAMI 30(10), 2008.
EccAnswer RegisterEcc(const FrameInput& before, const FrameInput& now);

}  // namespace trem::bench
