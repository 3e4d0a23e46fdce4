// Goal: RunHints draws from its target, gives the same chain for the same seed, and is plain Metropolis-Hastings when its tree has no
// levels. Method: linear-Gaussian targets, whose posterior is known in closed form; means and covariances of the draws are compared with it
// by batch means (50 batches, Student's t with 49 degrees of freedom). A test makes 27 comparisons; the threshold of 8 standard errors has
// a false alarm rate of 2e-10 each (6e-9 a test), and the seeds are fixed.

#include "worker/registration/hints.h"

#include <cmath>
#include <limits>
#include <set>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/Dense>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mosaic/base/rng.h"
#include "worker/registration/hints_tree.h"

namespace trem {
namespace {

constexpr int kDimension = 6;
constexpr int kTerms = 256;
constexpr double kThreshold = 8.0;

// y = A x + n, n ~ N(0, I); prior N(0, 0.2^2 I), strong enough to matter.
class LinearTarget : public AdditiveTarget {
 public:
  explicit LinearTarget(std::uint64_t seed) : a_(kTerms, kDimension), y_(kTerms) {
    Rng rng({seed, 1});
    for (double& element : a_.reshaped()) element = rng.Normal();
    for (double& element : y_) element = 0.3 + rng.Normal();
    const Eigen::MatrixXd precision = a_.transpose() * a_ + kPriorPrecision * Eigen::MatrixXd::Identity(kDimension, kDimension);
    covariance = precision.inverse();
    mean = covariance * (a_.transpose() * y_);
    shape = Eigen::MatrixXd(covariance.llt().matrixL());
  }
  int term_count() const override { return kTerms; }
  double LogTerms(std::span<const int> term_indices, const HintsState& x) const override {
    double sum = 0.0;
    for (const int i : term_indices) {
      const double residual = y_[i] - a_.row(i).dot(x);
      sum += residual * residual;
    }
    return -0.5 * sum;
  }
  double LogPrior(const HintsState& x) const override { return -0.5 * kPriorPrecision * x.squaredNorm(); }

  Eigen::VectorXd mean;
  Eigen::MatrixXd covariance;
  HintsMatrix shape;

 private:
  static constexpr double kPriorPrecision = 25.0;
  Eigen::MatrixXd a_;
  Eigen::VectorXd y_;
};

// (batch mean of `values` - expected) in standard errors estimated from 50 batches.
double StandardErrorsOff(const std::vector<double>& values, double expected) {
  constexpr int kBatches = 50;
  const std::size_t length = values.size() / kBatches;
  double sum = 0.0;
  double sum_of_squares = 0.0;
  for (std::size_t b = 0; b < kBatches; ++b) {
    double batch = 0.0;
    for (std::size_t i = b * length; i < (b + 1) * length; ++i) batch += values[i] / static_cast<double>(length);
    sum += batch;
    sum_of_squares += batch * batch;
  }
  const double mean = sum / kBatches;
  const double variance = (sum_of_squares - kBatches * mean * mean) / (kBatches - 1);
  return (mean - expected) / std::sqrt(variance / kBatches);
}

// The largest of all comparisons of first and second moments with mean and `covariance`, in standard errors.
double LargestDeviation(const std::vector<HintsState>& draws, const LinearTarget& target, const Eigen::MatrixXd& covariance) {
  double largest = 0.0;
  std::vector<double> values(draws.size());
  for (int j = 0; j < kDimension; ++j) {
    for (std::size_t i = 0; i < draws.size(); ++i) values[i] = draws[i][j];
    largest = std::max(largest, std::abs(StandardErrorsOff(values, target.mean[j])));
    for (int k = j; k < kDimension; ++k) {
      for (std::size_t i = 0; i < draws.size(); ++i) values[i] = (draws[i][j] - target.mean[j]) * (draws[i][k] - target.mean[k]);
      largest = std::max(largest, std::abs(StandardErrorsOff(values, covariance(j, k))));
    }
  }
  return largest;
}

HintsOptions LongRun(int levels) {
  HintsOptions options;
  options.levels = levels;
  options.branching = 4;
  options.leaf_size = 8;
  options.sweeps = 20000;
  options.burn_in = 200;
  options.seed_key = {7, 3, 11};
  options.keep_draws = true;
  return options;
}

struct Case {
  int levels;
  std::vector<double> temperatures;
  HintsChildOrder order;
};

class HintsPosteriorTest : public testing::TestWithParam<Case> {};

TEST_P(HintsPosteriorTest, DrawsHaveTheMeanAndCovarianceOfThePosterior) {
  const LinearTarget target(5);
  HintsOptions options = LongRun(GetParam().levels);
  options.temperatures = GetParam().temperatures;
  options.child_order = GetParam().order;
  const HintsState start = HintsState::Zero(kDimension);
  const Result<HintsResult> result = RunHints(target, start, target.shape, options);
  ASSERT_TRUE(result.ok()) << result.status().ToString();
  ASSERT_EQ(result->draws.size(), 20000U);
  EXPECT_LT(LargestDeviation(result->draws, target, target.covariance), kThreshold);
  // Control: the same comparison rejects a posterior that is a quarter wider.
  EXPECT_GT(LargestDeviation(result->draws, target, 1.25 * target.covariance), kThreshold);
  // The summary is that of the draws.
  HintsState mean = HintsState::Zero(kDimension);
  for (const HintsState& draw : result->draws) mean += draw / 20000.0;
  EXPECT_LT((mean - result->mean).norm(), 1e-12);
  EXPECT_LT((Eigen::MatrixXd(result->covariance) - target.covariance).norm(), 0.3 * target.covariance.norm());
  EXPECT_EQ(result->acceptance_rates.size(), static_cast<std::size_t>(GetParam().levels) + 1);
  EXPECT_GT(result->acceptance_rates[0], 0.1);
}

INSTANTIATE_TEST_SUITE_P(Trees, HintsPosteriorTest,
                         testing::Values(Case{0, {}, HintsChildOrder::kRandom}, Case{1, {}, HintsChildOrder::kRandom},
                                         Case{2, {}, HintsChildOrder::kRandom}, Case{2, {1.0, 1.5, 3.0}, HintsChildOrder::kRandom},
                                         Case{1, {}, HintsChildOrder::kPalindrome}));

TEST(HintsTest, SameSeedGivesTheSameChainAndAnotherSeedAnother) {
  const LinearTarget target(5);
  HintsOptions options = LongRun(2);
  options.sweeps = 100;
  const HintsState start = HintsState::Zero(kDimension);
  const HintsResult first = RunHints(target, start, target.shape, options).value();
  const HintsResult second = RunHints(target, start, target.shape, options).value();
  EXPECT_EQ(first.draws, second.draws);
  EXPECT_EQ(first.mean, second.mean);
  EXPECT_EQ(first.best, second.best);
  EXPECT_EQ(first.term_evaluations, second.term_evaluations);
  options.seed_key[2] += 1;
  EXPECT_NE(RunHints(target, start, target.shape, options).value().draws, first.draws);
}

TEST(HintsTest, WithoutLevelsItIsPlainMetropolisHastings) {
  const LinearTarget target(5);
  HintsOptions options = LongRun(0);
  options.sweeps = 500;
  options.burn_in = 0;
  options.step = 0.7;
  const HintsState start = HintsState::Zero(kDimension);
  const HintsResult result = RunHints(target, start, target.shape, options).value();

  // Written from the textbook, with the same random numbers: d normals for a proposal, one uniform to accept it.
  std::vector<int> all(kTerms);
  for (int i = 0; i < kTerms; ++i) all[static_cast<std::size_t>(i)] = i;
  const auto log_density = [&](const HintsState& x) { return target.LogTerms(all, x) + target.LogPrior(x); };
  Rng rng({options.seed_key[0], options.seed_key[1], options.seed_key[2]});
  HintsState x = start;
  for (const HintsState& draw : result.draws) {
    HintsState normals(kDimension);
    for (double& normal : normals) normal = rng.Normal();
    const HintsState y = x + options.step * (target.shape * normals);
    if (std::log(1.0 - rng.Uniform()) <= log_density(y) - log_density(x)) x = y;
    ASSERT_EQ(draw, x);
  }
  EXPECT_EQ(result.term_evaluations, 501 * kTerms) << "one evaluation a step; that of the present state is remembered";
  EXPECT_EQ(result.full_evaluations, 501.0);
}

// Metropolis-Hastings with the burn-in's Robbins-Monro recursion, from the textbook: adaptation that went on after burn-in, or did not take
// place, would give other draws.
TEST(HintsTest, TheStepIsAdaptedInBurnInAndFrozenAfterIt) {
  const LinearTarget target(5);
  HintsOptions options = LongRun(0);
  options.sweeps = 300;
  options.burn_in = 40;
  options.step = 3.0;
  const HintsResult result = RunHints(target, HintsState::Zero(kDimension), target.shape, options).value();
  std::vector<int> all(kTerms);
  for (int i = 0; i < kTerms; ++i) all[static_cast<std::size_t>(i)] = i;
  const auto log_density = [&](const HintsState& x) { return target.LogTerms(all, x) + target.LogPrior(x); };
  const auto chain = [&](int adapted_sweeps) {
    Rng rng({options.seed_key[0], options.seed_key[1], options.seed_key[2]});
    HintsState x = HintsState::Zero(kDimension);
    double step = options.step;
    std::vector<HintsState> draws;
    for (int sweep = 0; sweep < options.burn_in + options.sweeps; ++sweep) {
      HintsState normals(kDimension);
      for (double& normal : normals) normal = rng.Normal();
      const HintsState y = x + step * (target.shape * normals);
      const double log_ratio = log_density(y) - log_density(x);
      if (std::log(1.0 - rng.Uniform()) <= log_ratio) x = y;
      if (sweep < adapted_sweeps) step *= std::exp(std::pow(sweep + 1.0, -0.6) * (std::exp(std::min(log_ratio, 0.0)) - 0.3));
      if (sweep >= options.burn_in) draws.push_back(x);
    }
    return std::pair(draws, step);
  };
  const auto [draws, step] = chain(options.burn_in);
  EXPECT_EQ(result.draws, draws);
  EXPECT_DOUBLE_EQ(result.step, step);
  EXPECT_LT(step, 1.5) << "it has adapted";
  EXPECT_NE(result.draws, chain(options.burn_in + 1).first) << "control: one sweep more is noticed";
}

// Proposals about a centre that is off by a standard deviation, too wide, and that remember where they come from.
TEST(HintsTest, DrawsWithCentredProposalsHaveTheMeanAndCovarianceOfThePosterior) {
  const LinearTarget target(5);
  for (const double persistence : {0.0, 0.5}) {
    HintsOptions options = LongRun(0);
    options.centre = target.mean + target.shape * HintsState::Constant(kDimension, 0.4);
    options.persistence = persistence;
    const HintsResult result = RunHints(target, options.centre, 1.2 * target.shape, options).value();
    EXPECT_LT(LargestDeviation(result.draws, target, target.covariance), kThreshold) << persistence;
    EXPECT_GT(LargestDeviation(result.draws, target, 1.25 * target.covariance), kThreshold) << "control";
    EXPECT_GT(result.effective_draws, 2000.0);
  }
}

TEST(HintsTest, EffectiveDrawsOfAnAutoregressionAreThoseOfTheory) {
  constexpr int kCount = 40000;
  for (const double correlation : {0.0, 0.5, 0.9}) {
    Rng rng({1, 2});
    std::vector<HintsState> draws(kCount, HintsState::Zero(2));
    HintsState x = HintsState::Zero(2);
    for (HintsState& draw : draws) {
      for (double& element : x) element = correlation * element + rng.Normal();
      draw = x;
    }
    const double expected = kCount * (1.0 - correlation) / (1.0 + correlation);
    EXPECT_NEAR(EffectiveDraws(draws), expected, 0.2 * expected);
  }
  EXPECT_EQ(EffectiveDraws(std::vector<HintsState>(10, HintsState::Ones(2))), 1.0) << "a chain that never moved";
}

TEST(HintsTest, FindsItsWayFromAFarStartInTheDefaultNumberOfSweeps) {
  const LinearTarget target(6);
  HintsOptions options;
  options.leaf_size = 4;
  const HintsState start = target.mean + 100.0 * target.shape * HintsState::Constant(kDimension, 1.0 / std::sqrt(kDimension));
  const HintsResult result = RunHints(target, start, target.shape, options).value();
  // Standard deviations of the posterior; the start is 100 away.
  const Eigen::VectorXd whitened = Eigen::MatrixXd(target.shape).triangularView<Eigen::Lower>().solve(result.best - target.mean);
  EXPECT_LT(whitened.norm(), 10.0);
}

TEST(HintsTest, BestIsTheHighestDensityAmongTheDraws) {
  const LinearTarget target(5);
  HintsOptions options = LongRun(1);
  options.sweeps = 200;
  options.burn_in = 0;
  const HintsResult result = RunHints(target, HintsState::Zero(kDimension), target.shape, options).value();
  std::vector<int> all(kTerms);
  for (int i = 0; i < kTerms; ++i) all[static_cast<std::size_t>(i)] = i;
  double highest = -std::numeric_limits<double>::infinity();
  for (const HintsState& draw : result.draws) highest = std::max(highest, target.LogTerms(all, draw) + target.LogPrior(draw));
  EXPECT_EQ(result.best_log_density, highest);
}

// Impossible outside the unit interval, as a view that leaves the scene is.
class BoundedTarget : public AdditiveTarget {
 public:
  int term_count() const override { return 64; }
  double LogTerms(std::span<const int> term_indices, const HintsState& x) const override {
    if (x[0] < 0.0 || x[0] > 1.0) return std::numeric_limits<double>::quiet_NaN();
    return -0.001 * static_cast<double>(term_indices.size());
  }
  double LogPrior(const HintsState&) const override { return 0.0; }
};

TEST(HintsTest, NeverEntersStatesThatAreNotFinite) {
  HintsOptions options = LongRun(2);
  options.leaf_size = 4;
  options.step = 0.3;
  options.acceptance_target = 0.0;
  const HintsResult result = RunHints(BoundedTarget(), HintsState::Constant(1, 0.5), HintsMatrix::Identity(1, 1), options).value();
  std::vector<double> values;
  for (const HintsState& draw : result.draws) {
    ASSERT_GE(draw[0], 0.0);
    ASSERT_LE(draw[0], 1.0);
    values.push_back(draw[0]);
  }
  // What is left is uniform on [0, 1].
  EXPECT_LT(std::abs(StandardErrorsOff(values, 0.5)), kThreshold);
}

TEST(HintsTest, ReportsAnImpossibleStart) {
  const Result<HintsResult> result = RunHints(BoundedTarget(), HintsState::Constant(1, 2.0), HintsMatrix::Identity(1, 1), HintsOptions());
  ASSERT_FALSE(result.ok());
  EXPECT_EQ(result.status().code(), StatusCode::kFailed);
  EXPECT_THAT(result.status().message(), testing::HasSubstr("not finite at the start"));
}

TEST(HintsTreeTest, ChildrenPartitionTheirParentAndEverySubsetIsSpread) {
  const HintsTree tree = BuildHintsTree(1000, 3, 4, 10, 42);
  EXPECT_EQ(tree.leaf_level, 3);
  EXPECT_EQ(tree.nodes.size(), 1U + 4 + 16 + 64);
  EXPECT_EQ(tree.term_count(), 1000);
  for (const HintsTree::Node& node : tree.nodes) {
    EXPECT_TRUE(std::is_sorted(node.terms.begin(), node.terms.end()));
    // Spread over all terms: two neighbours of a subset of level l come from runs of 4^l terms that follow each other.
    const int run = 1 << (2 * node.level);
    EXPECT_LE(node.terms.front(), run);
    EXPECT_GE(node.terms.back(), 1000 - 2 * run);
    for (std::size_t i = 1; i < node.terms.size(); ++i) EXPECT_LT(node.terms[i] - node.terms[i - 1], 2 * run);
    if (node.children.empty()) {
      EXPECT_EQ(node.level, 3);
      continue;
    }
    std::set<int> united;
    std::size_t count = 0;
    for (const int child : node.children) {
      const std::vector<int>& terms = tree.nodes[static_cast<std::size_t>(child)].terms;
      united.insert(terms.begin(), terms.end());
      count += terms.size();
    }
    EXPECT_EQ(count, node.terms.size());
    EXPECT_EQ(std::vector<int>(united.begin(), united.end()), node.terms);
  }
}

TEST(HintsTreeTest, LeavesOutLevelsThatWouldMakeLeavesTooSmall) {
  EXPECT_EQ(BuildHintsTree(1000, 5, 4, 16, 0).leaf_level, 2);
  EXPECT_EQ(BuildHintsTree(15, 5, 4, 16, 0).leaf_level, 0);
  EXPECT_EQ(BuildHintsTree(1, 5, 2, 1, 0).leaf_level, 0);
}

TEST(HintsTreeTest, DependsOnTheSeedOnly) {
  const auto leaves = [](std::uint64_t seed) { return BuildHintsTree(256, 2, 4, 4, seed).nodes.back().terms; };
  EXPECT_EQ(leaves(1), leaves(1));
  EXPECT_NE(leaves(1), leaves(2));
}

}  // namespace
}  // namespace trem
