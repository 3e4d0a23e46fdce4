#pragma once

#include "worker/registration/scene_support.h"
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
  // Levels of reduction by 2 above the full resolution. 0 suffices when the prior mean is within about 4 px; with 3, a scan of starts at
  // the coarsest level and the descent from the best reach capture_sigma_px.
  int pyramid_levels = 0;
  // Standard deviation [sensor px] of a corner about the start that the reduced levels believe instead of the prior: they are there for
  // when the prior is wrong. The full resolution has the prior.
  double capture_sigma_px = 20.0;
  int iterations_max = 12;
  // The finest level ends with a step that moves no corner further than this [sensor px]. Convergence is quadratic: what is left after
  // such a step is below 0.001 px.
  double step_tolerance_px = 0.02;
  // Residuals beyond this many standard deviations lose influence (Huber). Lower: more robust, less efficient.
  double huber_sigmas = 3.0;
  GainOffset gain_offset = GainOffset::kMaximumLikelihood;
  int threads = 1;  // Of the full resolution; the result does not depend on it.
};

// Outcome of a registration, whatever the method.
struct Registration {
  View view;
  // What the frame's own noise and the prior leave uncertain of its place against the scene as it is, gain and offset marginalised
  // [px^2]: (A + L)^-1 (s A + L) (A + L)^-1 with A = J' W J / sigma^2, L the prior's information and s SceneSupport::own_share. The
  // scene's own uncertainty comes on top (worker/tre/segment.h).
  CornerMatrix corner_covariance = CornerMatrix::Zero(6, 6);
  Eigen::Matrix2d gain_offset_covariance = Eigen::Matrix2d::Zero();
  double residual_rms = 0.0;    // Robustly weighted, internal grey levels.
  double residual_sigma = 0.0;  // 1.4826 * median |residual|.
  double correlation = 0.0;     // sqrt(1 - explained-away variance), 0..1, on seen pixels.
  double overlap = 0.0;         // Part of the ROI's pixels with seen scene behind them.
  SceneSupport support;
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
