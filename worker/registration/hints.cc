#include "worker/registration/hints.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <string>
#include <utility>

#include "mosaic/base/check.h"
#include "mosaic/base/rng.h"
#include "worker/registration/hints_kernel.h"
#include "worker/registration/hints_tree.h"

namespace trem {
namespace {

// A state with an identity, so that the density of a state that was seen before is not computed again.
struct NamedState {
  HintsState x;
  std::uint64_t id = 0;
};

// A positive factor by its logarithm.
struct LogRatio {
  double log = 0.0;
  friend LogRatio operator*(LogRatio a, LogRatio b) { return {a.log + b.log}; }
  friend LogRatio operator/(LogRatio a, LogRatio b) { return {a.log - b.log}; }
};

// Stands for the logarithm of zero. Finite, so that differences of two impossible states are numbers; a move from a possible state
// to an impossible one is never accepted.
constexpr double kLogImpossible = -1e100;

// F_n of every node of the tree.
class NodeDensities {
 public:
  NodeDensities(const HintsTarget& target, const HintsTree& tree, std::span<const double> temperatures)
      : target_(target), tree_(tree), nodes_(target.NodesOf(tree)), temperatures_(static_cast<std::size_t>(tree.leaf_level) + 1, 1.0) {
    for (std::size_t i = 0; i < std::min(temperatures.size(), temperatures_.size()); ++i) temperatures_[i] = temperatures[i];
  }

  LogRatio Density(int node, const NamedState& state) {
    if (node != 0) return {Evaluate(node, state.x)};
    // The root's density at the present state is known from the step that accepted it; the other slot holds the latest candidate.
    for (const Known& known : root_) {
      if (known.id == state.id) return {known.log_density};
    }
    Known& slot = root_[0].id == current_id_ ? root_[1] : root_[0];
    slot = {state.id, Evaluate(0, state.x)};
    return {slot.log_density};
  }

  // The state in which the chain is now; its root density stays known.
  void SetCurrent(std::uint64_t id) { current_id_ = id; }
  std::int64_t term_evaluations() const { return term_evaluations_; }

 private:
  struct Known {
    std::uint64_t id = ~0ULL;
    double log_density = 0.0;
  };

  double Evaluate(int node, const HintsState& x) {
    const HintsTree::Node& n = tree_.nodes[static_cast<std::size_t>(node)];
    const double share = static_cast<double>(n.terms.size()) / tree_.term_count();
    term_evaluations_ += static_cast<std::int64_t>(n.terms.size());
    const double value = (nodes_->LogNode(node, x) + share * target_.LogPrior(x)) / temperatures_[static_cast<std::size_t>(n.level)];
    return std::isfinite(value) ? std::max(value, kLogImpossible) : kLogImpossible;
  }

  const HintsTarget& target_;
  const HintsTree& tree_;
  std::unique_ptr<HintsNodes> nodes_;
  std::vector<double> temperatures_;
  std::array<Known, 2> root_;
  std::uint64_t current_id_ = 0;
  std::int64_t term_evaluations_ = 0;
};

struct LevelCount {
  std::int64_t tried = 0;
  std::int64_t accepted = 0;
  double probability = 0.0;  // Sum of the probabilities of acceptance.
};

// The random choices. A leaf step draws d normals for its proposal, then one uniform for its acceptance, whatever the ratio; a parent
// draws its order first and one uniform last.
class RandomChooser {
 public:
  RandomChooser(const HintsTree& tree, const HintsMatrix& shape, const HintsOptions& options)
      : tree_(tree),
        shape_(shape),
        centre_(options.centre),
        persistence_(options.persistence),
        innovation_(std::sqrt(1.0 - options.persistence * options.persistence)),
        order_(options.child_order),
        rng_({options.seed_key[0], options.seed_key[1], options.seed_key[2]}),
        counts_(static_cast<std::size_t>(tree.leaf_level) + 1) {
    if (centre_.size() > 0) whitening_ = shape.inverse();
  }

  NamedState Propose(int /*leaf*/, const NamedState& x, LogRatio* hastings) {
    HintsState normals(x.x.size());
    for (double& normal : normals) normal = rng_.Normal();
    NamedState y{x.x, ++last_id_};
    if (centre_.size() == 0) {
      *hastings = {};  // A Gaussian around x is symmetric.
      y.x.noalias() += step * (shape_ * normals);
      return y;
    }
    y.x = centre_ + persistence_ * (x.x - centre_);
    y.x.noalias() += innovation_ * (shape_ * normals);
    // Reversible for N(centre, shape shape'): q(x|y) / q(y|x) = N(x) / N(y).
    *hastings = {0.5 * ((whitening_ * (y.x - centre_)).squaredNorm() - (whitening_ * (x.x - centre_)).squaredNorm())};
    return y;
  }

  int ChildOrder(int node, HintsOrder* order) {
    const int count = static_cast<int>(tree_.nodes[static_cast<std::size_t>(node)].children.size());
    std::iota(order->begin(), order->begin() + count, 0);
    if (order_ == HintsChildOrder::kPalindrome) {
      std::reverse_copy(order->begin(), order->begin() + count, order->begin() + count);
      return 2 * count;
    }
    for (std::size_t i = static_cast<std::size_t>(count); i > 1; --i) {
      std::swap((*order)[i - 1], (*order)[rng_.UniformIndex(static_cast<std::uint32_t>(i))]);
    }
    return count;
  }

  bool Accept(int node, LogRatio ratio) {
    LevelCount& count = counts_[static_cast<std::size_t>(tree_.nodes[static_cast<std::size_t>(node)].level)];
    ++count.tried;
    count.probability += std::exp(std::min(ratio.log, 0.0));
    const bool accepted = std::log(1.0 - rng_.Uniform()) <= ratio.log;
    count.accepted += accepted ? 1 : 0;
    return accepted;
  }

  // Counts since the last call.
  std::vector<LevelCount> TakeCounts() { return std::exchange(counts_, std::vector<LevelCount>(counts_.size())); }

  double step = 1.0;

 private:
  const HintsTree& tree_;
  const HintsMatrix& shape_;
  HintsState centre_;
  double persistence_;
  double innovation_;
  HintsMatrix whitening_;
  HintsChildOrder order_;
  Rng rng_;
  std::uint64_t last_id_ = 0;
  std::vector<LevelCount> counts_;
};

void CheckOptions(const HintsTarget& target, const HintsState& start, const HintsMatrix& shape, const HintsOptions& options) {
  TREM_CHECK(target.term_count() >= 1);
  TREM_CHECK(start.size() >= 1 && shape.rows() == start.size() && shape.cols() == start.size());
  TREM_CHECK(options.sweeps >= 1 && options.burn_in >= 0);
  TREM_CHECK(options.step >= 0.0 && std::isfinite(options.step));
  TREM_CHECK(options.centre.size() == 0 || options.centre.size() == start.size());
  TREM_CHECK(options.persistence >= 0.0 && options.persistence < 1.0);
  TREM_CHECK(options.acceptance_target >= 0.0 && options.acceptance_target < 1.0);
  TREM_CHECK_MSG(options.temperatures.empty() || options.temperatures[0] == 1.0, "the root's temperature must be 1");
  for (const double temperature : options.temperatures) TREM_CHECK(temperature > 0.0);
}

// Robbins-Monro: how much the logarithm of the step changes after burn-in sweep `sweep` (from 0) in which the root counted this.
double StepCorrection(int sweep, const LevelCount& root, double acceptance_target) {
  const double probability = root.tried == 0 ? 0.0 : root.probability / static_cast<double>(root.tried);
  return std::pow(sweep + 1.0, -0.6) * (probability - acceptance_target);
}

void Summarise(const std::vector<HintsState>& draws, HintsResult* result) {
  const Eigen::Index d = draws.front().size();
  result->mean = HintsState::Zero(d);
  for (const HintsState& draw : draws) result->mean += draw;
  result->mean /= static_cast<double>(draws.size());
  result->covariance = HintsMatrix::Zero(d, d);
  result->effective_draws = static_cast<double>(draws.size());
  if (draws.size() < 2) return;
  result->effective_draws = EffectiveDraws(draws);
  for (const HintsState& draw : draws) {
    const HintsState difference = draw - result->mean;
    result->covariance += difference * difference.transpose();
  }
  result->covariance /= static_cast<double>(draws.size() - 1);
}

class AdditiveNodes : public HintsNodes {
 public:
  AdditiveNodes(const AdditiveTarget& target, const HintsTree& tree) : target_(target), tree_(tree) {}
  double LogNode(int node, const HintsState& x) override {
    return target_.LogTerms(tree_.nodes[static_cast<std::size_t>(node)].terms, x);
  }

 private:
  const AdditiveTarget& target_;
  const HintsTree& tree_;
};

}  // namespace

std::unique_ptr<HintsNodes> AdditiveTarget::NodesOf(const HintsTree& tree) const { return std::make_unique<AdditiveNodes>(*this, tree); }

double EffectiveDraws(const std::vector<HintsState>& draws) {
  const std::size_t n = draws.size();
  HintsState mean = HintsState::Zero(draws.front().size());
  for (const HintsState& draw : draws) mean += draw / static_cast<double>(n);
  const auto autocovariance = [&](std::size_t lag) {
    HintsState sum = HintsState::Zero(mean.size());
    for (std::size_t i = 0; i + lag < n; ++i) sum += (draws[i] - mean).cwiseProduct(draws[i + lag] - mean);
    return sum;
  };
  const HintsState variance = autocovariance(0);
  if (!(variance.minCoeff() > 0.0)) return 1.0;
  double sum = -1.0;  // Twice the autocorrelations of all lags but 0, and 1: the first pair holds lag 0.
  for (std::size_t lag = 0; lag + 1 < n; lag += 2) {
    const HintsState pair = autocovariance(lag) + autocovariance(lag + 1);
    const double correlation = pair.cwiseQuotient(variance).mean();
    if (!(correlation > 0.0)) break;
    sum += 2.0 * correlation;
  }
  return std::clamp(static_cast<double>(n) / std::max(sum, 1e-9), 1.0, static_cast<double>(n));
}

Result<HintsResult> RunHints(const HintsTarget& target, const HintsState& start, const HintsMatrix& shape, const HintsOptions& options) {
  CheckOptions(target, start, shape, options);
  const std::array<std::uint64_t, 3>& key = options.seed_key;
  const HintsTree tree =
      BuildHintsTree(target.term_count(), options.levels, options.branching, options.leaf_size, Rng({key[0], key[1], key[2]})());
  NodeDensities densities(target, tree, options.temperatures);
  RandomChooser chooser(tree, shape, options);
  const double leaf_count = std::pow(options.branching, tree.leaf_level);
  chooser.step = options.step > 0.0 ? options.step : 2.4 / std::sqrt(static_cast<double>(start.size()) * leaf_count);

  NamedState state{start, 0};
  HintsResult result;
  result.best = start;
  result.best_log_density = densities.Density(0, state).log;
  if (result.best_log_density <= kLogImpossible) {
    return Failed("HINTS cannot start: the log-density of " + std::to_string(target.term_count()) +
                  " terms and the prior is not finite at the start; start from a state that the target can explain");
  }
  std::vector<HintsState> draws;
  draws.reserve(static_cast<std::size_t>(options.sweeps));
  for (int sweep = -options.burn_in; sweep < options.sweeps; ++sweep) {
    if (sweep == 0) chooser.TakeCounts();
    const HintsMove<NamedState, LogRatio> move = HintsStep<LogRatio>(tree, 0, state, densities, chooser);
    if (move.moved) {
      state = move.state;
      densities.SetCurrent(state.id);
      const double log_density = densities.Density(0, state).log;
      if (log_density > result.best_log_density) {
        result.best_log_density = log_density;
        result.best = state.x;
      }
    }
    if (sweep >= 0) {
      draws.push_back(state.x);
    } else if (options.acceptance_target > 0.0 && options.centre.size() == 0) {
      chooser.step *= std::exp(StepCorrection(sweep + options.burn_in, chooser.TakeCounts().front(), options.acceptance_target));
    }
  }

  Summarise(draws, &result);
  for (const LevelCount& count : chooser.TakeCounts()) {
    result.acceptance_rates.push_back(count.tried == 0 ? 0.0 : static_cast<double>(count.accepted) / static_cast<double>(count.tried));
  }
  result.step = chooser.step;
  result.term_evaluations = densities.term_evaluations();
  result.full_evaluations = static_cast<double>(result.term_evaluations) / target.term_count();
  if (options.keep_draws) result.draws = std::move(draws);
  return result;
}

}  // namespace trem
