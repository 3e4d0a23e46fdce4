#pragma once

#include "mosaic/base/image.h"
#include "mosaic/geometry/roi.h"

namespace trem {

// The prior on the scene: local spatial smoothness, sum over horizontal and vertical neighbours of psi(difference).
enum class StructurePriorKind {
  kHuberTv,   // psi quadratic below delta, linear above: keeps edges.
  kMembrane,  // psi quadratic.
};

struct StructurePrior {
  StructurePriorKind kind = StructurePriorKind::kHuberTv;
  // Difference [grey levels per cell] from which Huber's psi is linear. Lower keeps weaker edges and shows more noise.
  float delta = 4.0F;

  // Adds weight * d(sum psi)/dS to `gradient` on `region`; psi'(d) = d below delta. Differences across the region's border are left out.
  void AddGradient(const Image<float>& scene, const Roi& region, float weight, Image<float>* gradient) const;
  // A bound on the diagonal of a separable majoriser of sum psi: each cell takes part in 4 differences, each of curvature <= 1, and
  // (a - b)^2 <= 2 a^2 + 2 b^2.
  static constexpr float kCurvatureMax = 8.0F;
  float curvature_max() const { return kCurvatureMax; }
};

}  // namespace trem
