#include "worker/sensor/resolution.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace trem {
namespace {

constexpr double kVisible = 0.02;

// Frequency [cycles/px] at which the kernel's modulation along the better of the two axes has fallen below kVisible.
double KernelLimit(const PsfKernel& kernel) {
  const double last = 0.5 * kernel.samples_per_pixel;
  for (double f = 0.02; f < last; f += 0.01) {
    double re[2] = {0.0, 0.0};
    double im[2] = {0.0, 0.0};
    double sum = 0.0;
    const double step = 2.0 * std::numbers::pi * f / kernel.samples_per_pixel;
    for (int y = 0; y < kernel.height; ++y) {
      for (int x = 0; x < kernel.width; ++x) {
        const double value = kernel.at(x, y);
        sum += value;
        re[0] += value * std::cos(step * x);
        im[0] += value * std::sin(step * x);
        re[1] += value * std::cos(step * y);
        im[1] += value * std::sin(step * y);
      }
    }
    if (std::max(std::hypot(re[0], im[0]), std::hypot(re[1], im[1])) < kVisible * sum) return f;
  }
  return last;
}

}  // namespace

ResolutionCeiling FindResolutionCeiling(const PsfParameters& parameters, double q, int ratio) {
  ResolutionCeiling ceiling;
  ceiling.optics_cutoff = q > 0.0 ? 1.0 / q : 0.0;
  ceiling.grid_nyquist = 0.5 * ratio;
  const bool measured = parameters.model == PsfModel::kKernelFile;
  ceiling.detector_zero = measured ? KernelLimit(parameters.kernel) : 1.0 / parameters.fill_factor;
  ceiling.cycles_per_px = ceiling.grid_nyquist;
  ceiling.limit = "Nyquist frequency of the scene grid";
  if (ceiling.detector_zero < ceiling.cycles_per_px) {
    ceiling.cycles_per_px = ceiling.detector_zero;
    ceiling.limit = measured ? "end of the measured kernel's transfer function" : "zero of the detector's transfer function";
  }
  if (q > 0.0 && ceiling.optics_cutoff < ceiling.cycles_per_px) {
    ceiling.cycles_per_px = ceiling.optics_cutoff;
    ceiling.limit = "cut-off of the optics";
  }
  return ceiling;
}

}  // namespace trem
