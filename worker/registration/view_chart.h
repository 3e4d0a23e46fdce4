#pragma once

#include <Eigen/Core>

#include "worker/registration/gauss_newton.h"
#include "worker/registration/hints.h"

namespace trem {

// Coordinates for the geometry of a view: x in R^d stands for the corner displacements basis * x [sensor px] from `centre`.
struct ViewChart {
  View centre;
  Roi roi;
  HintsMatrix basis;  // (6 or 8) x d.

  int dimension() const { return static_cast<int>(basis.cols()); }
  // The geometry at the first d elements of `x`; gain and offset are the centre's.
  View At(const HintsState& x) const;
};

// All corner displacements that the prior speaks of (6 or 8), about the prior's mean.
ViewChart FullChart(const ViewPrior& prior, const Roi& roi);

// Four: translation x, y, rotation about the ROI's centre and scale, each in units of the displacement [sensor px] that it gives a corner.
ViewChart SimilarityChart(const ViewPrior& prior, const Roi& roi);

}  // namespace trem
