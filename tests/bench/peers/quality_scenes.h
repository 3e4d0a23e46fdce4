#pragma once

#include <CLI/CLI.hpp>
#include <functional>
#include <string>

#include "mosaic/base/status.h"
#include "tests/bench/peers/bench_scene.h"

namespace trem::bench {

// The scenes of the quality benches: procedural ground with bar targets and spoked wheels, and crops of a photograph, under a dwelling
// camera with rotation, zoom, gain and offset drift.
struct SceneSettings {
  std::string truth;  // Photograph like the shared sample data's brighton_park.jpg; empty: procedural ground only.
  int frames = 30;
  int roi_px = 151;
  double noise_sigma = 2.0;
  double psf_sigma_px = 0.6;

  // Adds all but the number of frames to a program's options.
  void Declare(CLI::App* app);
};

// Calls `use` with every scene of one seed: noise, motion and procedural ground depend on it. kInvalidInput for a photograph that is too
// small; ends at the first error.
Status ForEachScene(const SceneSettings& settings, int seed, const std::function<Status(const BenchScene&)>& use);

}  // namespace trem::bench
