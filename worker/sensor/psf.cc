#include "worker/sensor/psf.h"

#include <cmath>
#include <string>

namespace trem {
namespace {

constexpr double kTailMass = 1e-3;

double NormalCdf(double x) { return 0.5 * std::erfc(-x / std::sqrt(2.0)); }

}  // namespace

Result<SeparablePsf> MakePsf(const PsfParameters& parameters, int ratio) {
  if (!(parameters.sigma_px >= 0.05 && parameters.sigma_px <= 3.0)) {
    return InvalidInput("sensor.psf_sigma_px is " + std::to_string(parameters.sigma_px) + "; expected 0.05 .. 3 sensor pixels");
  }
  if (!(parameters.fill_factor > 0.0 && parameters.fill_factor <= 1.0)) {
    return InvalidInput("sensor.fill_factor is " + std::to_string(parameters.fill_factor) + "; expected (0, 1]");
  }
  if (ratio < 1 || ratio > 8) return InvalidInput("tre.ratio is " + std::to_string(ratio) + "; expected 2, 3 or 4");
  const double sigma = parameters.sigma_px * ratio;
  const double half_box = 0.5 * parameters.fill_factor * ratio;
  const auto density = [&](double x) { return (NormalCdf((x + half_box) / sigma) - NormalCdf((x - half_box) / sigma)) / (2.0 * half_box); };
  std::vector<double> taps{density(0.0)};
  double mass = taps[0];
  for (int i = 1; i < 8 * ratio + 8 && mass < 1.0 - kTailMass; ++i) {
    taps.push_back(density(i));
    mass += 2.0 * taps.back();
  }
  SeparablePsf psf;
  for (const double tap : taps) psf.taps.push_back(static_cast<float>(tap / mass));
  return psf;
}

}  // namespace trem
