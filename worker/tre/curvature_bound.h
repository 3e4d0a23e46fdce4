#pragma once

#include <vector>

#include "worker/registration/target.h"
#include "worker/registration/view.h"
#include "worker/sensor/psf.h"

namespace trem {

// Bounds what one frame can add to the data term's curvature B' W of any cell, without looking at its pixels.
//
// A frame's samples lie on a lattice of the scene plane, each moved to its nearest cell. With taps t(i) <= a g(x) for |x - i| <= 1/2, g a
// Gaussian of standard deviation s, what they add to a cell is at most a^2 times a sum of Gaussians over the lattice itself, and that is,
// by Poisson's formula, at most (1 + 2 q + 2 q^4 + ...)^2 / D with D the lattice's cells a pixel, q = exp(-2 pi^2 s^2 / l^2), l its longest
// step. Of a PSF of 0.6 px at 3:1 that is 1.6 times what is added on average, of narrower ones up to 2.6.
class CurvatureBound {
 public:
  explicit CurvatureBound(const Psf& psf);

  // Of the frame `observation` at `view`, in a buffer that covers `extent` [cells]. Infinite where there is no bound of this kind: PSFs
  // that are not one symmetric separable term, views with perspective.
  float Of(const Observation& observation, const View& view, const Roi& extent) const;

 private:
  // g and a^2.
  struct Envelope {
    double sigma = 0.0;
    double factor = 0.0;
  };

  int radius_ = 0;
  std::vector<Envelope> envelopes_;
};

}  // namespace trem
