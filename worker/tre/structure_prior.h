#pragma once

#include "mosaic/base/image.h"
#include "mosaic/geometry/roi.h"

namespace trem {

// The prior on the scene: what is assumed of any ground. psi is Huber's: d^2 / 2 up to delta, delta (|d| - delta / 2) beyond.
enum class StructurePriorKind {
  kHuberTv,      // sum of psi over differences of horizontal and vertical neighbours: keeps edges.
  kMembrane,     // The same differences, squared: smooths everything alike.
  kLaplacian,    // 1/2 sum of the squared 5-point Laplacian: leaves slopes alone, prefers few bends.
  kBilateralTv,  // sum over shifts (l, m), |l|, |m| <= 2, of 0.7^(|l| + |m|) psi(S - shifted S): judges by a wider neighbourhood.
};

// The slope of the prior's energy along one cell's own axis, and a curvature that bounds the energy from above about the present
// value: a step of -slope / curvature never raises it.
struct CellSlope {
  float slope = 0.0F;
  float curvature = 0.0F;
};

// All energies are sums over the cells of a region alone: differences across its border are left out (free border).
// Sources: Huber-Markov, Schultz & Stevenson, IEEE Trans. IP 5(6), 1996; bilateral TV, Farsiu et al., IEEE Trans. IP 13(10), 2004, with
// psi for the absolute value.
struct StructurePrior {
  StructurePriorKind kind = StructurePriorKind::kHuberTv;
  // Difference [grey levels per cell] from which Huber's psi is linear. Lower keeps weaker edges and shows more noise. HUBER_TV and
  // BILATERAL_TV only.
  float delta = 4.0F;

  // Adds weight * d(energy)/dS to `gradient` on `region`.
  void AddGradient(const Image<float>& scene, const Roi& region, float weight, Image<float>* gradient) const;
  // Of the energy, at one cell of `region`.
  CellSlope SlopeAt(const Image<float>& scene, const Roi& region, int x, int y) const;
  // A bound on a diagonal majoriser of the energy, whatever the scene: HUBER_TV and MEMBRANE 8 (each cell takes part in 4 differences
  // of curvature <= 1, and (a - b)^2 <= 2 a^2 + 2 b^2), LAPLACIAN 64 (the Laplacian's spectrum ends at 8), BILATERAL_TV 4 times the
  // sum of its shifts' weights.
  float curvature_max() const;
  // Of HUBER_TV and MEMBRANE.
  static constexpr float kCurvatureMax = 8.0F;
};

}  // namespace trem
