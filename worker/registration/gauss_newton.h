#pragma once

#include "worker/registration/target.h"
#include "worker/registration/view.h"

namespace trem {

// What is believed of the view before looking at the pixels: Gaussian about `mean` with `information` (inverse covariance) over corner
// displacements [1/px^2], and Gaussian gain and offset. The size of `information`, 6 x 6 or 8 x 8, is the view model that is fitted.
struct ViewPrior {
  View mean;
  CornerMatrix information = CornerMatrix::Zero(6, 6);
  double gain_sigma = 0.1;
  double offset_sigma = 20.0;
};

// How gain and offset are treated while the geometry is found. Both have the Gaussian prior of ViewPrior.
enum class GainOffset {
  kMaximumLikelihood,  // Estimated together with the geometry.
  kMarginalised,       // Integrated out: the geometry is the mode of its own marginal posterior.
};

struct GaussNewtonOptions {
  // Levels of reduction by 2 above the full resolution. 0 suffices when the prior mean is within about 4 px; 3 reaches about 16 px and
  // costs a third more.
  int pyramid_levels = 0;
  int iterations_max = 12;
  // A level ends when no corner moves further than this [sensor px].
  double step_tolerance_px = 0.002;
  // Residuals beyond this many standard deviations lose influence (Huber). Lower: more robust, less efficient.
  double huber_sigmas = 3.0;
};

// Outcome of a registration, whatever the method.
struct Registration {
  View view;
  // Laplace approximation: (J' W J / sigma^2 + prior)^-1 over the corner displacements, gain and offset marginalised [px^2].
  CornerMatrix corner_covariance = CornerMatrix::Zero(6, 6);
  Eigen::Matrix2d gain_offset_covariance = Eigen::Matrix2d::Zero();
  double residual_rms = 0.0;    // Robustly weighted, internal grey levels.
  double residual_sigma = 0.0;  // 1.4826 * median |residual|.
  double correlation = 0.0;     // sqrt(1 - explained-away variance), 0..1, on seen pixels.
  double overlap = 0.0;         // Part of the ROI's pixels with seen scene behind them.
  double motion_from_prior_px = 0.0;
  bool converged = false;
};

// Maximum a posteriori view: minimises
//
//   sum_u s(u) rho((I(u) - g P(M u) - o) / sigma) + prior,   s = n / (n + 1) for cells seen n times, rho Huber's
//
// by Gauss-Newton over 6 or 8 corner displacements, gain and offset, from `start`. Deterministic; the sums run row by row in a fixed order.
// Source: Lucas & Kanade 1981; Baker & Matthews, IJCV 56(3) 2004 (forward compositional). A registration without enough overlap comes
// back with overlap < 0.05 and converged == false.
Registration RegisterGaussNewton(const Observation& observation, const Reference& reference, const ViewPrior& prior, const View& start,
                                 const GaussNewtonOptions& options);

// What RegisterGaussNewton would report of `view` without moving it: residuals, correlation, overlap, Laplace covariance.
Registration EvaluateView(const Observation& observation, const Reference& reference, const ViewPrior& prior, const View& view);

}  // namespace trem
