#pragma once

#include "tests/bench/peers/bench_scene.h"

namespace trem::bench {

// OpenCV contrib's multi-frame super-resolution: L1 data term, bilateral total variation, chained dense optical flow (Farneback) as
// registration. Source: Farsiu et al., IEEE Trans. Image Processing 13(10), 2004; Mitzel et al., DAGM 2009.
struct BtvSettings {
  int radius = 4;  // 2 radius + 1 frames are used.
  int iterations = 180;
  double lambda = 0.03;
  double alpha = 0.7;
  double tau = 1.3;
  double blur_factor = 1.0;  // On the true sensor's blur.
};

struct BtvAnswer {
  Image<float> answer;   // Of frame 0, on the answers' grid but for the library's own offset.
  double seconds = 0.0;  // CPU time of this one frame: two optical flows and the iterations.
};

// Enlarges frame 0 threefold from `settings.radius` frames on each side of it in a chain ... 4 2 0 1 3 ...; the scene must have
// 2 radius + 1 frames at least. Gains and offsets are taken back first (the method has no photometry).
BtvAnswer RunBtv(const BenchScene& scene, const BtvSettings& settings);

}  // namespace trem::bench
