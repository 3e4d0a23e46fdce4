#pragma once

#include "worker/tre/automatic_regularisation.h"
#include "worker/tre/information_update.h"
#include "worker/tre/kept_frames.h"

namespace trem {

// What frames that a scene was not made from say of the structure weight.
struct HeldOutWeight {
  double log_factor = 0.0;  // On the weight that was asked about.
  int solutions = 0;        // Scenes that were solved for.
};

// Finds the weight whose converged scene is nearest to the truth in the band that is handed out.
//
// A tile in the middle of `buffer` is solved from its present scene and the samples `sums` without those held out, under lambda 2^k. With
// S_k the solutions, D = S_k+1 - S_k and M their mean, d/dk |F (S - truth)|^2 / 2 = <F (M - truth), F D>, F: InEmittedBand. The frames held
// out see B (truth - M) + noise, and what B takes from the scene at the frequencies of F D is nearly a factor, so
//
//   s_k = sum over their samples of w r (F' F D)(x),   r = sample - prediction of M, limited to 3 sigma,
//
// has the sign of what the truth says: positive as long as more weight helps. The zero between two k is found by going up or down from
// k = 0. It counts as a measurement of log lambda with the variance of s by the samples' noise, beside `start` with a standard deviation
// of 0.7. `update` solves, its prior that of `start`.
HeldOutWeight FindHeldOutWeight(const KeptFrames& frames, const Accumulated& sums, const StructureWeight& start, int ratio,
                                double noise_sigma, const SceneBuffer& buffer, InformationUpdate* update);

}  // namespace trem
