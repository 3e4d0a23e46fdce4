#pragma once

#include <memory>

#include "worker/registration/hints.h"
#include "worker/registration/pixel_terms.h"
#include "worker/registration/view_chart.h"

namespace trem {

// How gain and offset enter the density of a view.
enum class Photometry {
  kJoint,         // They are two more elements of the state, after the geometry, as differences from the prior's mean.
  kProfiled,      // At each view the weighted least squares fit of the node's pixels. Draws are then of the profile likelihood, which is
                  // narrower than the posterior.
  kMarginalised,  // Integrated out under their Gaussian prior, for Gaussian residuals with PixelTerms' frozen robust factors as weights.
};

// The log posterior of a view given the pixels of a frame, for RunHints: state = chart coordinates [, gain, offset].
//
//   kJoint, kProfiled   - sum of s w rho(r / sigma) - the cost of missing pixels, rho Huber's
//   kMarginalised       log of the integral of exp(- sum of s w f r^2 / (2 sigma^2)) p(gain) p(offset), f the factors of `terms`
//
// and the Gaussian prior over displacements (and, when joint or profiled, gain and offset). `terms` and `prior` outlive the target; nodes
// of one target at a time (they share the samples in `terms`).
class ViewTarget : public HintsTarget {
 public:
  ViewTarget(PixelTerms* terms, const ViewPrior& prior, ViewChart chart, Photometry photometry, double sigma)
      : terms_(*terms), prior_(prior), chart_(std::move(chart)), photometry_(photometry), sigma_(sigma) {}

  int dimension() const { return chart_.dimension() + (photometry_ == Photometry::kJoint ? 2 : 0); }
  int term_count() const override { return terms_.count(); }
  double LogPrior(const HintsState& x) const override;
  std::unique_ptr<HintsNodes> NodesOf(const HintsTree& tree) const override;

  // log-density of the pixels of `range` at x.
  double LogPixels(const PixelTerms::Range& range, const HintsState& x) const;
  // The view at x, with its gain and offset: those of the state, or the fit of all pixels.
  View ViewAt(const HintsState& x) const;

 private:
  PixelTerms& terms_;
  const ViewPrior& prior_;
  ViewChart chart_;
  Photometry photometry_;
  double sigma_;
};

}  // namespace trem
