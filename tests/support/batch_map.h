#pragma once

#include <span>

#include "mosaic/base/image.h"
#include "worker/registration/target.h"
#include "worker/registration/view.h"
#include "worker/sensor/psf.h"
#include "worker/tre/structure_prior.h"

namespace trem::testing {

// One frame whose view is taken as known.
struct BatchFrame {
  Observation observation;
  View view;
};

struct BatchMapOptions {
  StructurePrior prior;
  double weight = 0.02;  // lambda below.
  int iterations_max = 400;
  double tolerance = 1e-3;  // Ends when no cell that a frame reaches moves further in an iteration [grey levels].
};

// The reference that the engine's recursions are held against: the scene on `extent` [cells] that minimises
//
//   1/2 sum_t sum_u w_t(u) (g_t (C_t B S)(u) + o_t - I_t(u))^2 + lambda sum psi(grad S)
//
// over all frames together, B: Blur, C_t: Keys' bicubic sampling of the view, the same sensor model as ForwardOperator. Pixels that are
// NaN or whose support leaves `extent` are left out. Accelerated gradient (FISTA without a proximal part) in the diagonal metric
// B |C|' |C| 1 + lambda curvature, with restarts when the objective would grow, from `start` (of the extent's size). No robustness.
// Source: Beck & Teboulle, SIAM J. Imaging Sci. 2(1), 2009; O'Donoghue & Candes 2015 (restarts).
Image<float> BatchMap(const SeparablePsf& psf, const Roi& extent, std::span<const BatchFrame> frames, const BatchMapOptions& options,
                      Image<float> start);

}  // namespace trem::testing
