#include "worker/registration/view_target.h"

#include <vector>

namespace trem {
namespace {

class ViewNodes : public HintsNodes {
 public:
  ViewNodes(const ViewTarget& target, PixelTerms* terms, const HintsTree& tree) : target_(target), ranges_(tree.nodes.size()) {
    // Leaves, which stand last and in the order of their parents, get places one after the other: every node is then a run of places. The
    // root has the places in the order of the image, which its samples walk through faster.
    for (std::size_t node = 0; node < tree.nodes.size(); ++node) {
      if (tree.nodes[node].children.empty() && node > 0) ranges_[node] = terms->Append(tree.nodes[node].terms);
    }
    for (std::size_t node = tree.nodes.size(); node > 0; --node) {
      const std::vector<int>& children = tree.nodes[node - 1].children;
      if (children.empty()) continue;
      ranges_[node - 1] = {ranges_[static_cast<std::size_t>(children.front())].begin, ranges_[static_cast<std::size_t>(children.back())].end};
    }
    ranges_[0] = terms->All();
  }

  double LogNode(int node, const HintsState& x) override { return target_.LogPixels(ranges_[static_cast<std::size_t>(node)], x); }

 private:
  const ViewTarget& target_;
  std::vector<PixelTerms::Range> ranges_;
};

}  // namespace

double ViewTarget::LogPrior(const HintsState& x) const {
  const CornerVector d = chart_.basis * x.head(chart_.dimension());
  double log = -0.5 * d.dot(prior_.information * d);
  if (photometry_ == Photometry::kJoint) {
    const double gain = x(chart_.dimension()) / prior_.gain_sigma;
    const double offset = x(chart_.dimension() + 1) / prior_.offset_sigma;
    log -= 0.5 * (gain * gain + offset * offset);
  }
  return log;
}

std::unique_ptr<HintsNodes> ViewTarget::NodesOf(const HintsTree& tree) const { return std::make_unique<ViewNodes>(*this, &terms_, tree); }

double ViewTarget::LogPixels(const PixelTerms::Range& range, const HintsState& x) const {
  terms_.Sample(range, chart_.At(x));
  const View& mean = prior_.mean;
  if (photometry_ == Photometry::kJoint) {
    const int d = chart_.dimension();
    return -terms_.Cost(range, mean.gain + x(d), mean.offset + x(d + 1), sigma_);
  }
  const PixelMoments moments = terms_.Moments(range, mean.gain, mean.offset);
  const GainOffsetPosterior fit = FitGainOffset(moments, prior_, sigma_);
  if (photometry_ == Photometry::kMarginalised) return fit.log_marginal - kMissingCost * moments.missing;
  const double gain = (fit.gain - mean.gain) / prior_.gain_sigma;
  const double offset = (fit.offset - mean.offset) / prior_.offset_sigma;
  return -terms_.Cost(range, fit.gain, fit.offset, sigma_) - 0.5 * (gain * gain + offset * offset);
}

View ViewTarget::ViewAt(const HintsState& x) const {
  View view = chart_.At(x);
  if (photometry_ == Photometry::kJoint) {
    view.gain = prior_.mean.gain + x(chart_.dimension());
    view.offset = prior_.mean.offset + x(chart_.dimension() + 1);
    return view;
  }
  terms_.Sample(terms_.All(), view);
  const GainOffsetPosterior fit = FitGainOffset(terms_.Moments(terms_.All(), prior_.mean.gain, prior_.mean.offset), prior_, sigma_);
  view.gain = fit.gain;
  view.offset = fit.offset;
  return view;
}

}  // namespace trem
