#pragma once

#include <cmath>
#include <map>
#include <string>

#include "worker/sensor/psf.h"
#include "worker/sensor/psf_terms.h"

namespace trem {

// A comet: nothing symmetric, nothing separable about it.
inline PsfKernel CometKernel() {
  PsfKernel kernel;
  kernel.width = 17;
  kernel.height = 16;
  kernel.samples_per_pixel = 5.0;
  for (int y = 0; y < 16; ++y) {
    for (int x = 0; x < 17; ++x) {
      const double along = 0.8 * (x - 6) + 0.6 * (y - 6);
      const double across = -0.6 * (x - 6) + 0.8 * (y - 6);
      const double head = std::exp(-0.5 * (std::pow(x - 6, 2) + std::pow(y - 6, 2)) / 4.0);
      const double tail = along > 0.0 ? 0.5 * std::exp(-along / 4.0 - 0.5 * across * across) : 0.0;
      kernel.values.push_back(static_cast<float>(head + tail));
    }
  }
  return kernel;
}

// One PSF of every kind, ratio 3, by name.
inline std::map<std::string, Psf> SamplePsfs() {
  PsfParameters gaussian{0.6, 0.9};
  PsfParameters optics;
  optics.model = PsfModel::kOptics;
  optics.sigma_px = 0.0;
  optics.q = 0.6;
  PsfParameters smeared = gaussian;
  smeared.smear_px = 1.7;
  smeared.smear_direction_rad = 0.5;
  PsfParameters file;
  file.model = PsfModel::kKernelFile;
  file.kernel = CometKernel();
  return {{"gaussian", *MakePsf(gaussian, 3)},
          {"optics", *MakePsf(optics, 3)},
          {"smeared gaussian", *MakePsf(smeared, 3)},
          {"asymmetric file", *MakePsf(file, 3)}};
}

}  // namespace trem
