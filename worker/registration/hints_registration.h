#pragma once

#include <cstdint>

#include "worker/registration/gauss_newton.h"

namespace trem {

enum class HintsUse {
  kFull,     // Draws at full resolution from the posterior: the mean is the view, the covariance of the draws is its covariance.
  kCapture,  // A search on images reduced fourfold, for a start within reach of Gauss-Newton: the best state is the view.
};

// Registers with HINTS (worker/registration/hints.h) over 6 corner displacements, gain and offset. The target's terms are about 1024
// interleaved pixels with Huber's log-density; pixels that fall on unseen scene count as outliers, so that leaving the scene is never
// an advantage. `stream` names the random stream. kFull starts with the Laplace approximation at the prior's mean as the proposal's
// shape, so the prior's mean has to be within Gauss-Newton's reach of the answer; kCapture reaches about 24 px.
Registration RegisterHints(const Observation& observation, const Reference& reference, const ViewPrior& prior, HintsUse use,
                           const std::uint64_t (&stream)[3]);

}  // namespace trem
