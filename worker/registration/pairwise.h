#pragma once

#include <cstdint>
#include <functional>

#include "worker/registration/gauss_newton.h"
#include "worker/registration/hints.h"
#include "worker/registration/view_chart.h"

namespace trem {

// The pairwise search of the first year of TRE: at every scale, each pair of parameters in turn is moved to the best place of a small
// square grid around where it is, the others fixed. From coarse to fine. Kept as the baseline that HINTS is measured against.
struct PairwiseOptions {
  // Grid step [sensor px of corner displacement] of the first scale, halved from scale to scale. 0: the prior's standard deviation, at
  // least 0.5 and at most 4 px. The search reaches about three times this.
  double first_step_px = 0.0;
  // The last scale's step is at most this: about half of it remains as an error in every parameter.
  double last_step_px = 1.0 / 64.0;
  // Grid points on each side of the present place along each axis: 1 is a grid of 3 x 3, 2 one of 5 x 5.
  int grid_half = 1;
  // Rounds over all pairs at a scale; fewer when a round moves nothing.
  int rounds_max = 3;
};

struct PairwiseResult {
  HintsState state;
  double log_density = 0.0;
  std::int64_t evaluations = 0;
};

// Maximises `log_density` from `start` (not finite: never moved to). `on_scale`, when given, is called with the present state before each
// scale; it may change what `log_density` computes.
PairwiseResult SearchPairs(const std::function<double(const HintsState&)>& log_density, const HintsState& start, double first_step,
                           const PairwiseOptions& options, const std::function<void(const HintsState&)>& on_scale);

// Registers over the coordinates of `chart` (its centre is the prior's mean) against all pixels: Huber's loss and the prior. Gain and
// offset are profiled: the weighted least squares fit under their prior at every evaluation, with robust weights that are set anew at the
// start of each scale. Covariance: Laplace. `pixel_evaluations`, when given, receives evaluations x pixels.
Registration RegisterPairwise(const Observation& observation, const Reference& reference, const ViewPrior& prior, const ViewChart& chart,
                              const PairwiseOptions& options, std::int64_t* pixel_evaluations = nullptr);

}  // namespace trem
