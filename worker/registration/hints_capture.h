#pragma once

#include <cstdint>

#include "worker/registration/gauss_newton.h"

namespace trem {

// Finds a view within reach of Gauss-Newton, from a prior's mean that is up to about 24 px and 15 degrees off (at 151 x 151 px):
//
// 1. Scan: a regular grid of translations and rotations about the prior's mean on the coarsest images that still hold 150 pixels,
//    each scored by its log posterior with gain and offset profiled.
// 2. Chains: HINTS from each of the best few places that are not neighbours of a better one, on images of twice that resolution.
// 3. The best state of all chains, followed by HINTS at twice the resolution again.
//
// A search, not a sampler of the posterior: only the best state is used. Deterministic for the same stream. Returns EvaluateView of what
// it found. `pixel_evaluations`, when given, is added to.
Registration CaptureByHints(const Observation& observation, const Reference& reference, const ViewPrior& prior,
                            const std::uint64_t (&stream)[3], std::int64_t* pixel_evaluations = nullptr);

}  // namespace trem
