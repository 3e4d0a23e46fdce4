#include "worker/registration/pairwise.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "worker/registration/pixel_terms.h"
#include "worker/registration/view_target.h"

namespace trem {
namespace {

// Moves the coordinates a and b of `*best` to the best point of their grid; true when it moved.
bool SearchPair(const std::function<double(const HintsState&)>& log_density, Eigen::Index a, Eigen::Index b, double step, int grid_half,
                PairwiseResult* best) {
  const HintsState centre = best->state;
  bool moved = false;
  for (int j = -grid_half; j <= grid_half; ++j) {
    for (int i = -grid_half; i <= grid_half; ++i) {
      if (i == 0 && j == 0) continue;
      HintsState candidate = centre;
      candidate(a) += i * step;
      candidate(b) += j * step;
      const double log = log_density(candidate);
      ++best->evaluations;
      if (!(log > best->log_density)) continue;
      best->log_density = log;
      best->state = candidate;
      moved = true;
    }
  }
  return moved;
}

// The largest standard deviation of a corner under the prior [px].
double PriorSigmaPx(const ViewPrior& prior) {
  CornerMatrix information = prior.information;
  information.diagonal().array() += 1e-4;  // A flat prior has 100 px.
  const CornerMatrix covariance = information.inverse();
  return std::sqrt(covariance.diagonal().maxCoeff());
}

}  // namespace

PairwiseResult SearchPairs(const std::function<double(const HintsState&)>& log_density, const HintsState& start, double first_step,
                           const PairwiseOptions& options, const std::function<void(const HintsState&)>& on_scale) {
  TREM_CHECK(start.size() >= 2 && first_step > 0.0 && options.last_step_px > 0.0 && options.grid_half >= 1);
  PairwiseResult best;
  best.state = start;
  for (double step = first_step;; step *= 0.5) {
    if (on_scale) on_scale(best.state);
    best.log_density = log_density(best.state);
    ++best.evaluations;
    bool moved = true;
    for (int round = 0; round < options.rounds_max && moved; ++round) {
      moved = false;
      for (Eigen::Index a = 0; a < start.size(); ++a) {
        for (Eigen::Index b = a + 1; b < start.size(); ++b) moved |= SearchPair(log_density, a, b, step, options.grid_half, &best);
      }
    }
    if (step <= options.last_step_px) return best;
  }
}

Registration RegisterPairwise(const Observation& observation, const Reference& reference, const ViewPrior& prior, const ViewChart& chart,
                              const PairwiseOptions& options, std::int64_t* pixel_evaluations) {
  PixelTerms terms(observation, reference, 0, 0);
  const ViewTarget target(&terms, prior, chart, Photometry::kProfiled, observation.noise_sigma);
  const auto log_density = [&](const HintsState& x) { return target.LogPixels(terms.All(), x) + target.LogPrior(x); };
  const auto set_robust_weights = [&](const HintsState& x) {
    const View view = target.ViewAt(x);
    terms.FreezeRobustFactors(view.gain, view.offset, observation.noise_sigma);
  };
  const double first_step = options.first_step_px > 0.0 ? options.first_step_px : std::clamp(PriorSigmaPx(prior), 0.5, 4.0);
  const PairwiseResult found =
      SearchPairs(log_density, HintsState::Zero(chart.dimension()), first_step, options, set_robust_weights);
  if (pixel_evaluations != nullptr) *pixel_evaluations = found.evaluations * terms.count();
  Registration registration = EvaluateView(observation, reference, prior, target.ViewAt(found.state));
  registration.converged = registration.overlap > 0.0 && std::isfinite(found.log_density);
  return registration;
}

}  // namespace trem
