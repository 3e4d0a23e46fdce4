#pragma once

#include "worker/registration/target.h"
#include "worker/registration/view.h"
#include "worker/tre/scene_buffer.h"

namespace trem {

// What a registered frame leaves of the scene's prediction, pixel by pixel of the ROI. Keeps its memory between frames.
struct FrameResidual {
  Image<float> predicted;  // gain * (B S) + offset, bilinear; NaN where the frame meets no seen scene.
  Image<float> value;      // Frame - predicted; NaN where either is not there or the frame's weight is 0.
  // Variance that noise, the scene's own noise and its model error explain: noise_sigma^2 (1 / weight + 1 / n) + (k(n) * contrast)^2,
  // n: frames that have seen the cell, contrast: range of `predicted` over 3 x 3 pixels. k stands for the error of registration and
  // aliasing as a part of the contrast; it falls as the scene is seen by more frames.
  Image<float> variance;
  Image<float> frames_seen;  // n.

  // `buffer.prediction` is what the frame was registered to: the frame is not in it yet. The result does not depend on `threads`.
  void Compute(const Observation& observation, const View& view, const SceneBuffer& buffer, int threads = 1);

 private:
  // Each works on rows [begin, end).
  void Predict(const Observation& observation, const View& view, const SceneBuffer& buffer, int begin, int end);
  void Explain(const Observation& observation, int begin, int end);
};

}  // namespace trem
