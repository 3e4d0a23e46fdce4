#pragma once

#include <Eigen/Core>
#include <array>

#include "mosaic/base/image.h"
#include "worker/registration/row_moments.h"
#include "worker/registration/target.h"
#include "worker/registration/view.h"

namespace trem {

// The parameters of a registration: 6 or 8 corner displacements [sensor px], then gain and offset.
using Parameters = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, 10, 1>;
using ParameterMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 10, 10>;

// One resolution level: reduced frame and reference, and how their grids lie in the full ones.
struct RegistrationLevel {
  const Image<float>* frame = nullptr;
  const Image<float>* weights = nullptr;  // Of the frame's pixels; null: all 1.
  const Image<float>* prediction = nullptr;
  const Image<float>* seen = nullptr;
  double frame_step = 1.0;      // Full-resolution sensor pixels per level pixel.
  double reference_step = 1.0;  // Full-resolution cells per level cell.
  int pixel_stride = 1;         // Uses every n-th pixel of every n-th row.
  int threads = 1;              // The result does not depend on it.
};

// Coordinates of pixel k of a grid reduced by `step`: the centre of the block it averages.
inline double FullFromLevel(double k, double step) { return k * step + 0.5 * (step - 1.0); }
inline double LevelFromFull(double x, double step) { return (x - 0.5 * (step - 1.0)) / step; }

// |residual| of the pixels, counted; bins of 1/64 sigma up to 16 sigma.
struct ResidualHistogram {
  static constexpr int kBins = 1024;
  static constexpr double kBinsPerSigma = 64.0;
  std::array<int, kBins> counts{};
  long long total = 0;
  // Median of |residual| [sigma]; 0 when empty, 16 when more than half lie beyond.
  double Median() const;
  void Add(const ResidualHistogram& other);
};

// Gauss-Newton's normal equations at one view, a step = b, and what validation needs. Everything but `a` and `b` is per pixel used.
struct NormalEquations {
  ParameterMatrix a;  // J' W J / sigma^2 over corner displacements, gain, offset; J of the prediction.
  Parameters b;       // J' W r / sigma^2.
  // Slopes of the sums that gain and offset's own information consists of, with respect to the corner displacements:
  // d(sum w P P), d(sum w P) [per px], weights held.
  Eigen::Matrix<double, Eigen::Dynamic, 1, 0, 8, 1> d_pp;
  Eigen::Matrix<double, Eigen::Dynamic, 1, 0, 8, 1> d_p;
  double seen_weight = 0.0;    // Sum of weights before the robust factor.
  double robust_weight = 0.0;  // Sum of weights w.
  double sum_w_r2 = 0.0;
  double sum_w_i = 0.0;  // I: the frame's pixels.
  double sum_w_i2 = 0.0;
  double sum_w_p = 0.0;
  double sum_w_p2 = 0.0;
  long long pixels = 0;
  long long candidates = 0;
  double overlap() const { return candidates > 0 ? static_cast<double>(pixels) / static_cast<double>(candidates) : 0.0; }
};

// Accumulates the normal equations of one level at `view`: the derivation is in docs/decisions (registration). `noise_sigma` [grey
// levels] is that of a pixel of weight 1; residuals beyond `huber_sigmas` of it lose influence. `histogram` (may be null) receives
// every used |residual| of every second row. Cost: about 15 cycles a pixel with 8 lanes. Sums: float in 8 lanes along a row, double
// from row to row, so that the bytes are the same on every machine.
NormalEquations AccumulateNormal(const RegistrationLevel& level, const Roi& roi, const Reference& reference, const View& view,
                                 ViewModel model, double noise_sigma, double huber_sigmas, ResidualHistogram* histogram);

}  // namespace trem
