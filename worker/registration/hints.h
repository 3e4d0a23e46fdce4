#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "mosaic/base/status.h"
#include "worker/registration/hints_tree.h"

namespace trem {

// At most ten unknowns (eight of a view, gain, offset), so a state lives on the stack.
inline constexpr int kHintsDimensionMax = 10;
using HintsState = Eigen::Matrix<double, Eigen::Dynamic, 1, Eigen::ColMajor, kHintsDimensionMax, 1>;
using HintsMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, kHintsDimensionMax, kHintsDimensionMax>;

// The log-density of every node of a tree but for the prior, held ready for many evaluations.
class HintsNodes {
 public:
  virtual ~HintsNodes() = default;
  // Of `node` at x, up to a constant of the node. A value that is not finite means that x is impossible.
  virtual double LogNode(int node, const HintsState& x) = 0;
};

// A log-density with subsets: log p(x) = log-density of all terms + prior(x) + const. Functions of the state alone: what they return must
// not change during a run (the scene is frozen while a frame is registered).
class HintsTarget {
 public:
  virtual ~HintsTarget() = default;
  virtual int term_count() const = 0;
  virtual double LogPrior(const HintsState& x) const = 0;
  // Node 0 has to be the density of all terms, which the draws come from. Any density may stand at the others; the nearer it is to the
  // node's share of the root's, the more of its moves the root accepts. `tree` and the target outlive what is returned.
  virtual std::unique_ptr<HintsNodes> NodesOf(const HintsTree& tree) const = 0;
};

// A log-density that is a sum of terms, such as the log-likelihood of independent pixels: a node's is the sum of its terms.
class AdditiveTarget : public HintsTarget {
 public:
  // Sum of the named terms at x (ascending indices). Not finite: x is impossible.
  virtual double LogTerms(std::span<const int> term_indices, const HintsState& x) const = 0;
  std::unique_ptr<HintsNodes> NodesOf(const HintsTree& tree) const override;
};

enum class HintsChildOrder {
  kRandom,      // Every parent step visits its children once, in a random order. Exact.
  kPalindrome,  // There and back: each child twice. Exact as well; twice the work below a parent for a move that reaches further.
};

struct HintsOptions {
  // Levels below the root. 0: plain Metropolis-Hastings on all terms. More levels make a sweep of leaf moves between two evaluations
  // of the whole; too many, and the parents reject what the leaves did.
  int levels = 3;
  // Children of a node, 2..16.
  int branching = 4;
  // Least terms of a leaf; levels that would make smaller leaves are left out.
  int leaf_size = 16;
  // Temperature of each level, root first; F of a level is divided by it. The root's must be 1, else the draws are of another density.
  // Levels without an entry have 1. Above 1 lets leaves move further than their data allow.
  std::vector<double> temperatures;
  HintsChildOrder child_order = HintsChildOrder::kRandom;
  // Root iterations that count, after `burn_in` iterations that adapt the step and are thrown away. A start far off lengthens the step
  // while the chain travels: where the covariance of the draws matters, give it as many iterations again to shorten the step.
  int sweeps = 40;
  int burn_in = 20;
  // Length of a leaf's proposal in units of the proposal's shape: y = x + step * shape * N(0, I); where adaptation starts. 0: automatic,
  // 2.4 / sqrt(d * leaf count), with which the moves of a sweep's leaves add up to the best step of plain Metropolis-Hastings when the
  // shape is that of the posterior.
  double step = 0.0;
  // Where not empty, a leaf proposes y = centre + persistence (x - centre) + sqrt(1 - persistence^2) * shape * N(0, I) instead, which is
  // reversible for a Gaussian about `centre`; step and adaptation are not used. For draws near the optimum, when centre and shape are
  // those of the posterior: successive draws are then nearly independent. The Hastings term keeps it exact whatever they are.
  HintsState centre;
  double persistence = 0.0;  // [0, 1).
  // Robbins-Monro (in burn-in only, then frozen) steers the step towards this mean probability of acceptance at the root. The root's,
  // because it is the one that too long a step starves; 0.3 was best or near it for 0 to 3 levels. 0: no adaptation.
  double acceptance_target = 0.3;
  // Names the random stream: {job seed, window, frame}, for instance. The same key gives the same chain.
  std::array<std::uint64_t, 3> seed_key = {0, 0, 0};
  // Whether HintsResult::draws is filled.
  bool keep_draws = false;
};

struct HintsResult {
  HintsState best;                // The state of highest log-density seen at the root, burn-in included.
  double best_log_density = 0.0;  // Of the root; constants as in the target.
  HintsState mean;                // Of the draws.
  HintsMatrix covariance;         // Of the draws (divided by sweeps - 1; zero for one draw). d x d.
  // By level, root first, over the counted sweeps: accepted / tried. A parent tries when one of its children moved.
  std::vector<double> acceptance_rates;
  double effective_draws = 0.0;       // How many independent draws the counted sweeps are worth: EffectiveDraws.
  double step = 0.0;                  // The frozen step.
  std::int64_t term_evaluations = 0;  // Terms evaluated in all, burn-in included.
  double full_evaluations = 0.0;      // The same in units of the whole target: term_evaluations / term_count.
  std::vector<HintsState> draws;      // When asked for; one a counted sweep.
};

// Draws from the target with HINTS (see hints_kernel.h): leaves make cheap random walk moves on subsets of the terms; parents accept or
// reject what their children did, with the correction that makes the draws come exactly from the target.
//
// When to use it: from a start that is many standard deviations off, where a sweep of leaf moves goes further than one move of the whole
// (a linear target of 1024 terms in 6 dimensions, started 300 standard deviations off with step 1: 140 full evaluations to arrive with
// 3 levels, 800 with none). Near the optimum, with a proposal of the posterior's shape, plain Metropolis-Hastings (levels = 0) gives more
// independent draws for the same number of term evaluations.
//
//   F_n(x) = [sum of node n's terms at x + |n|/N log prior(x)] / temperature of n's level
// `start` has d elements, 1 <= d <= kHintsDimensionMax; `shape` is a d x d factor of the proposal's covariance, for example the lower Cholesky factor of
// (J'J)^-1. Cost of a sweep: at most (2 * levels + 1) * term_count term evaluations with random order.
// A target whose terms are profiled over further unknowns gives draws of the profile likelihood, not of the marginal.
// kFailed when the target is not finite at `start`. Precondition: options in their ranges (checked).
Result<HintsResult> RunHints(const HintsTarget& target, const HintsState& start, const HintsMatrix& shape, const HintsOptions& options);

// Effective number of independent draws among successive `draws`: n / (1 + 2 sum of autocorrelations), averaged over the coordinates and
// summed up to Geyer's initial positive sequence (Statistical Science 7(4), 1992, 3.3). 1 .. n. Not empty.
double EffectiveDraws(const std::vector<HintsState>& draws);

}  // namespace trem
