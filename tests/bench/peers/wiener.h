#pragma once

#include "tests/bench/peers/bench_scene.h"

namespace trem::bench {

struct TunedAnswer {
  Image<float> answer;
  double db = 0.0;
  double setting = 0.0;  // What the tuning chose; what it is depends on the method.
};

// Deconvolves `blurred` (on the answers' grid) with the Wiener filter of the true sensor,
//
//   G(f) = H(f) / (H(f)^2 + k (|f| / f0)^p),   H: transfer function of Gaussian and detector,
//
// k and p tuned to the truth of this very scene: the best case for the method. `setting` is k.
// Source: R. Gonzalez and R. Woods, Digital Image Processing, 5.8, with a power law for the scene's spectrum.
TunedAnswer TunedWiener(const BenchScene& scene, const Image<float>& blurred);

// Shift-and-add with the true registration and the true gain and offset: every sample to its nearest cell, averaged; cells without a
// sample from their neighbours. Source: Elad and Hel-Or, IEEE Trans. Image Processing 10(8), 2001.
Image<float> ShiftAndAdd(const BenchScene& scene);

}  // namespace trem::bench
