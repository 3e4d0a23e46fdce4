#pragma once

#include "mosaic/base/status.h"
#include "tests/bench/peers/bench_scene.h"

namespace trem::bench {

struct EngineAnswer {
  Image<float> answer;
  std::vector<double> corner_errors;  // Sensor px, one a registered frame.
  std::vector<View> views;            // Of frames 0, 1, ... where none was lost.
  int lost = 0;                       // Frames that it could not register.
  double noise_sigma = 0.0;
  double ms_per_frame = 0.0;
};

// The engine on the scene's frames, told the PSF and nothing else.
Result<EngineAnswer> RunEngine(const BenchScene& scene, EngineOptions options);

}  // namespace trem::bench
