#include "worker/sensor/psf_spectrum.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace trem {
namespace {

constexpr double kPeriod_px = 64.0;

double Sinc(double x) {
  const double t = std::numbers::pi * x;
  return std::abs(t) < 1e-8 ? 1.0 : std::sin(t) / t;
}

double GaussianMtf(double sigma_px, double f_squared) { return std::exp(-2.0 * std::pow(std::numbers::pi * sigma_px, 2) * f_squared); }

// Frequency [cycles/px] from which the transfer function is 0, or below 1e-7.
double LastFrequency(const PsfParameters& p) {
  const double gaussian = p.sigma_px > 0.0 ? std::sqrt(-std::log(1e-7) / 2.0) / (std::numbers::pi * p.sigma_px) : 1e9;
  return p.model == PsfModel::kOptics ? std::min(gaussian, 1.0 / p.q) : gaussian;
}

}  // namespace

double DiffractionMtf(double v) {
  if (v >= 1.0) return 0.0;
  return 2.0 / std::numbers::pi * (std::acos(v) - v * std::sqrt(1.0 - v * v));
}

double TransferFunction(const PsfParameters& p, double fx, double fy) {
  double value = Sinc(p.fill_factor * fx) * Sinc(p.fill_factor * fy) * GaussianMtf(p.sigma_px, fx * fx + fy * fy);
  if (p.model == PsfModel::kOptics) value *= DiffractionMtf(p.q * std::hypot(fx, fy));
  if (p.smear_px > 0.0) value *= Sinc(p.smear_px * (fx * std::cos(p.smear_direction_rad) + fy * std::sin(p.smear_direction_rad)));
  return value;
}

Eigen::MatrixXd SampleSpectrum(const PsfParameters& parameters, int ratio, int radius) {
  const int count = static_cast<int>(std::ceil(LastFrequency(parameters) * kPeriod_px)) + 1;
  // Over a quarter plane: what is even in fx (and then in fy) goes with cosines, what is odd in both, which only a smear has, with sines.
  Eigen::MatrixXd even(count, count);
  Eigen::MatrixXd odd = Eigen::MatrixXd::Zero(count, count);
  for (int j = 0; j < count; ++j) {
    for (int i = 0; i < count; ++i) {
      const double fx = i / kPeriod_px;
      const double fy = j / kPeriod_px;
      const double copies = (i == 0 ? 1.0 : 2.0) * (j == 0 ? 1.0 : 2.0);
      const double here = TransferFunction(parameters, fx, fy);
      const double mirrored = parameters.smear_px > 0.0 ? TransferFunction(parameters, -fx, fy) : here;
      even(j, i) = 0.5 * copies * (here + mirrored);
      odd(j, i) = 0.5 * copies * (here - mirrored);
    }
  }
  Eigen::MatrixXd cosines(2 * radius + 1, count);
  Eigen::MatrixXd sines(2 * radius + 1, count);
  for (int k = 0; k < count; ++k) {
    for (int x = -radius; x <= radius; ++x) {
      const double phase = 2.0 * std::numbers::pi * k / kPeriod_px * x / ratio;
      cosines(x + radius, k) = std::cos(phase);
      sines(x + radius, k) = std::sin(phase);
    }
  }
  Eigen::MatrixXd samples = cosines * even * cosines.transpose();
  if (parameters.smear_px > 0.0) samples -= sines * odd * sines.transpose();
  return samples / std::pow(kPeriod_px * ratio, 2);
}

}  // namespace trem
