#include "worker/sensor/psf.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <string>

#include "worker/sensor/psf_spectrum.h"
#include "worker/sensor/psf_terms.h"

namespace trem {
namespace {

constexpr double kTailMass = 1e-3;      // Of the closed-form taps, along one axis.
constexpr double kSmearedTail = 2e-3;   // Of a kernel without wings.
constexpr double kDiffractionTail = 0.03;
constexpr int kRadiusMax_px = 10;       // Of the kernel on the scene grid, smear not counted.

double NormalCdf(double x) { return 0.5 * std::erfc(-x / std::sqrt(2.0)); }

Status OutOfRange(const char* field, double found, const std::string& expected) {
  return InvalidInput(std::string("sensor.") + field + " is " + std::to_string(found) + "; expected " + expected);
}

Status Check(const PsfParameters& p, int ratio) {
  const bool needs_sigma = p.model == PsfModel::kGaussian;
  if (p.model != PsfModel::kKernelFile && (needs_sigma || p.sigma_px != 0.0) && !(p.sigma_px >= 0.05 && p.sigma_px <= 3.0)) {
    return OutOfRange("psf_sigma_px", p.sigma_px, "0.05 .. 3 sensor pixels");
  }
  if (!(p.fill_factor > 0.0 && p.fill_factor <= 1.0)) return OutOfRange("fill_factor", p.fill_factor, "(0, 1]");
  if (!(p.smear_px >= 0.0 && p.smear_px <= kSmearMax_px)) return OutOfRange("smear_px", p.smear_px, "0 .. 10 sensor pixels");
  if (!std::isfinite(p.smear_direction_rad)) return OutOfRange("smear_direction_deg", p.smear_direction_rad, "a finite angle");
  if (p.model == PsfModel::kOptics && !(p.q >= kOpticsQMin && p.q <= kOpticsQMax)) {
    return InvalidInput("sensor.wavelength_um * f_number / pixel_pitch_um is " + std::to_string(p.q) +
                        "; expected 0.05 .. 4: below, diffraction is no part of the blur (use psf_model: GAUSSIAN), above, the optics resolve less than the "
                        "sensor already samples");
  }
  if (p.model == PsfModel::kKernelFile) TREM_RETURN_IF_ERROR(CheckPsfKernel(p.kernel, "sensor.psf_kernel_path"));
  if (ratio < 1 || ratio > 8) return InvalidInput("tre.ratio is " + std::to_string(ratio) + "; expected 2, 3 or 4");
  return {};
}

Psf ClosedForm(const PsfParameters& parameters, int ratio) {
  const double sigma = parameters.sigma_px * ratio;
  const double half_box = 0.5 * parameters.fill_factor * ratio;
  const auto density = [&](double x) { return (NormalCdf((x + half_box) / sigma) - NormalCdf((x - half_box) / sigma)) / (2.0 * half_box); };
  std::vector<double> taps{density(0.0)};
  double mass = taps[0];
  for (int i = 1; i < 8 * ratio + 8 && mass < 1.0 - kTailMass; ++i) {
    taps.push_back(density(i));
    mass += 2.0 * taps.back();
  }
  Psf psf;
  for (const double tap : taps) psf.taps.push_back(static_cast<float>(tap / mass));
  return psf;
}

// The measured kernel on the scene grid, averaged along the smear.
Eigen::MatrixXd ResampleKernel(const PsfParameters& p, int ratio, int radius) {
  const KernelCentroid centroid = CentroidOf(p.kernel);
  const double step = p.kernel.samples_per_pixel / ratio;
  // Fine enough that the smeared kernel does not show the copies: 8 a scene cell or kernel sample, whichever is finer.
  const int copies = p.smear_px > 0.0 ? 1 + static_cast<int>(std::ceil(8.0 * p.smear_px * std::max<double>(ratio, p.kernel.samples_per_pixel))) : 1;
  Eigen::MatrixXd samples = Eigen::MatrixXd::Zero(2 * radius + 1, 2 * radius + 1);
  for (int c = 0; c < copies; ++c) {
    const double along = p.smear_px * p.kernel.samples_per_pixel * ((c + 0.5) / copies - 0.5);
    const double dx = along * std::cos(p.smear_direction_rad);
    const double dy = along * std::sin(p.smear_direction_rad);
    for (int j = -radius; j <= radius; ++j) {
      for (int i = -radius; i <= radius; ++i) samples(j + radius, i + radius) += SampleKernel(p.kernel, centroid, i * step - dx, j * step - dy);
    }
  }
  return samples;
}

// The smallest odd square about the centre that holds all but `tail` of the mass.
Eigen::MatrixXd Cut(const Eigen::MatrixXd& samples, double tail) {
  const Eigen::Index full = samples.rows() / 2;
  const double mass = samples.sum();
  for (Eigen::Index radius = 1; radius < full; ++radius) {
    const auto inner = samples.block(full - radius, full - radius, 2 * radius + 1, 2 * radius + 1);
    if (inner.sum() >= (1.0 - tail) * mass) return inner;
  }
  return samples;
}

}  // namespace

Result<Psf> MakePsf(const PsfParameters& parameters, int ratio) {
  TREM_RETURN_IF_ERROR(Check(parameters, ratio));
  if (parameters.model == PsfModel::kGaussian && parameters.smear_px == 0.0) return ClosedForm(parameters, ratio);
  const int radius = static_cast<int>(std::ceil((kRadiusMax_px + 0.5 * parameters.smear_px) * ratio));
  const Eigen::MatrixXd samples =
      parameters.model == PsfModel::kKernelFile ? ResampleKernel(parameters, ratio, radius) : SampleSpectrum(parameters, ratio, radius);
  // The transform leaves rounding of either sign where the PSF is 0.
  const Eigen::MatrixXd kernel = samples.cwiseMax(0.0);
  if (!(kernel.sum() > 0.0)) return InvalidInput("sensor.psf_kernel_path: the kernel falls between the cells of the scene; expected one about a pixel wide");
  return DecomposeKernel(Cut(kernel, parameters.model == PsfModel::kOptics ? kDiffractionTail : kSmearedTail));
}

}  // namespace trem
