#pragma once

#include <cstdint>

#include "worker/registration/gauss_newton.h"
#include "worker/registration/view_chart.h"

namespace trem {

enum class HintsUse {
  kFull,     // Draws at full resolution from the posterior: the mean is the view, the covariance of the draws is its covariance.
  kCapture,  // A search on reduced images for a start within reach of Gauss-Newton: the best state is the view.
};

struct HintsSettings {
  GainOffset gain_offset = GainOffset::kMaximumLikelihood;
  // Coordinates other than all corner displacements about the prior's mean (four, for instance). Null: all. kFull only.
  const ViewChart* chart = nullptr;
  // The way from the prior's mean to the neighbourhood of the optimum: sweeps of HINTS at each of up to three resolutions, on about
  // `travel_terms` interleaved pixels. More when the prior is poor.
  int travel_sweeps = 12;
  int travel_terms = 1024;
  // Draws that count, each from all pixels. Twice as many: a covariance that is better by a factor 1.4, in nearly twice the time.
  int draws = 48;
};

// Where the time went.
struct HintsCost {
  std::int64_t pixel_evaluations = 0;  // Of the sampler. The Gauss-Newton step and the summary evaluate the ROI 4 times more.
  double acceptance = 0.0;             // Of the draws.
  double effective_draws = 0.0;
};

// Registers with HINTS (worker/registration/hints.h). kFull, in two parts:
//
// Travel: HINTS with three levels of nested interleaved pixel subsets at falling resolution, gain and offset profiled. Its draws are burn-in
// and thrown away; the best state starts what follows.
// Draws: one Gauss-Newton step from there gives centre and shape of the proposals, (J'WJ / sigma^2 + prior)^-1, which are then frozen; the
// chain accepts or rejects with all pixels. So the draws are exactly from the posterior, however good the proposals were:
//   kMaximumLikelihood  over displacements, gain and offset together, with Huber's loss;
//   kMarginalised       over displacements, gain and offset integrated out. Huber's loss has no closed form there: each pixel keeps the
//                       weight that Huber's loss gives it at the centre of the proposals.
// Pixels that fall on unseen scene cost as much as outliers, so that leaving the scene is never an advantage. Where residuals are larger
// than the noise explains, the noise is taken as large as they are.
//
// The covariance is that of the draws, shrunk towards the proposals' by as many draws as it takes to be invertible and widened so that its
// inverse is unbiased (Hartlap et al. 2007) and that the Monte Carlo error of the mean is in it.
// `stream` names the random stream. kFull needs the prior's mean within Gauss-Newton's reach of the answer; kCapture reaches about 24 px
// and 15 degrees: see hints_capture.h.
Registration RegisterHints(const Observation& observation, const Reference& reference, const ViewPrior& prior, HintsUse use,
                           const std::uint64_t (&stream)[3], const HintsSettings& settings = {}, HintsCost* cost = nullptr);

}  // namespace trem
