// Goal: one HINTS step leaves the root's density invariant, exactly.
// Method: enumerate every sequence of random choices that HintsStep (the template that production runs) can make on a tree of four leaves
// and depth two, in exact rational arithmetic, with asymmetric proposals on three states; sum up pi(x) K(x, y) and compare it with pi(y) as
// fractions: the error must be 0. The same enumeration must see three well-known mistakes.

#include "worker/registration/hints_kernel.h"

#include <algorithm>
#include <array>
#include <iostream>
#include <numeric>
#include <vector>

#include <boost/multiprecision/cpp_int.hpp>

#include "gtest/gtest.h"
#include "worker/registration/hints_tree.h"

namespace trem {
namespace {

using Rational = boost::multiprecision::cpp_rational;

// The number type of the kernel, as a plain fraction.
struct ExactRatio {
  Rational value = 1;
  friend ExactRatio operator*(const ExactRatio& a, const ExactRatio& b) { return {a.value * b.value}; }
  friend ExactRatio operator/(const ExactRatio& a, const ExactRatio& b) { return {a.value / b.value}; }
};

constexpr int kStateCount = 3;
using Table = std::array<int, kStateCount>;

// Walks through all sequences of random choices, one run of the algorithm each.
class Choices {
 public:
  // Outcome of a random choice with the given probabilities, in this run.
  int Choose(const std::vector<Rational>& probabilities) {
    if (depth_ == made_.size()) made_.push_back({FirstPossible(probabilities, 0), probabilities});
    return made_[depth_++].outcome;
  }
  // Probability of the run that has just ended.
  Rational Probability() const {
    Rational product = 1;
    for (const Made& made : made_) product *= made.probabilities[static_cast<std::size_t>(made.outcome)];
    return product;
  }
  // Prepares the next run; false when every sequence has been seen.
  bool Next() {
    depth_ = 0;
    while (!made_.empty()) {
      made_.back().outcome = FirstPossible(made_.back().probabilities, made_.back().outcome + 1);
      if (made_.back().outcome < static_cast<int>(made_.back().probabilities.size())) return true;
      made_.pop_back();
    }
    return false;
  }

 private:
  struct Made {
    int outcome;
    std::vector<Rational> probabilities;
  };
  static int FirstPossible(const std::vector<Rational>& probabilities, int from) {
    while (from < static_cast<int>(probabilities.size()) && probabilities[static_cast<std::size_t>(from)] == 0) ++from;
    return from;
  }
  std::vector<Made> made_;
  std::size_t depth_ = 0;
};

// Densities of all seven nodes: root 0, parents 1 and 2, leaves 3..6 (checked in Error()).
struct TableTarget {
  std::array<Table, 7> density;
  std::array<std::size_t, 4> factor_of_leaf = {0, 1, 2, 3};  // A leaf's proposals go with its factor.
  ExactRatio Density(int node, int state) const {
    return {Rational(density[static_cast<std::size_t>(node)][static_cast<std::size_t>(state)])};
  }
};

enum class Order { kRandom, kPalindrome, kWithReplacement, kSingle, kFixed };

class EnumeratingChooser {
 public:
  EnumeratingChooser(const TableTarget& target, Order order, Choices* choices) : target_(target), order_(order), choices_(*choices) {}

  // Goes one state up with probability p, one down with 1 - p; p depends on leaf and state, so nothing is symmetric.
  int Propose(int leaf, int x, ExactRatio* hastings) {
    const int y = (x + (choices_.Choose({Up(leaf, x), 1 - Up(leaf, x)}) == 0 ? 1 : 2)) % kStateCount;
    const auto probability = [&](int from, int to) {
      return (from + 1) % kStateCount == to ? Up(leaf, from) : Rational(1 - Up(leaf, from));
    };
    hastings->value = probability(y, x) / probability(x, y);
    return y;
  }
  int ChildOrder(int /*node*/, HintsOrder* order) {
    const auto either = [this] { return choices_.Choose({Rational(1, 2), Rational(1, 2)}); };
    (*order)[0] = order_ == Order::kFixed || order_ == Order::kPalindrome ? 0 : either();
    if (order_ == Order::kSingle) return 1;
    (*order)[1] = order_ == Order::kWithReplacement ? either() : 1 - (*order)[0];
    (*order)[2] = 1;
    (*order)[3] = 0;
    return order_ == Order::kPalindrome ? 4 : 2;
  }
  bool Accept(int /*node*/, const ExactRatio& ratio) {
    const Rational probability = ratio.value < 1 ? ratio.value : Rational(1);
    return choices_.Choose({probability, 1 - probability}) == 0;
  }

 private:
  Rational Up(int leaf, int x) const {
    return Rational(1 + (static_cast<int>(target_.factor_of_leaf[static_cast<std::size_t>(leaf - 3)]) + 2 * x) % 3, 4);
  }
  const TableTarget& target_;
  Order order_;
  Choices& choices_;
};

struct NoCorrection : HintsRules {
  template <typename Ratio>
  static Ratio Correction(const Ratio& correction, const Ratio& /*change*/) {
    return correction;
  }
};

struct StopsAfterFirstAcceptance : HintsRules {
  static bool GoesOn(bool moved) { return !moved; }
};

using Distribution = std::array<Rational, kStateCount>;

// sum over x of pi(x) K(x, y), pi the density of `node`, K a step there.
template <typename Rules>
Distribution AfterAStep(const TableTarget& target, Order order, int node) {
  const HintsTree tree = BuildHintsTree(4, 2, 2, 1, 0);
  EXPECT_EQ(tree.nodes.size(), target.density.size());
  for (int i = 0; i < 7; ++i) EXPECT_EQ(tree.is_leaf(i), i >= 3);
  const Table& pi = target.density[static_cast<std::size_t>(node)];
  const Rational total = std::accumulate(pi.begin(), pi.end(), 0);
  Distribution after{};
  for (int x = 0; x < kStateCount; ++x) {
    Rational seen = 0;
    Choices choices;
    do {
      EnumeratingChooser chooser(target, order, &choices);
      const HintsMove<int, ExactRatio> move = HintsStep<ExactRatio, Rules>(tree, node, x, target, chooser);
      const Rational probability = choices.Probability();
      seen += probability;
      after[static_cast<std::size_t>(move.state)] += probability * pi[static_cast<std::size_t>(x)] / total;
      EXPECT_EQ(move.change.value, target.Density(node, move.state).value / target.Density(node, x).value);
    } while (choices.Next());
    EXPECT_EQ(seen, 1) << "the enumeration is complete";
  }
  return after;
}

// max over y of |after(y) - pi(y)|.
Rational LargestDifference(const Distribution& after, const Table& pi) {
  const Rational total = std::accumulate(pi.begin(), pi.end(), 0);
  Rational error = 0;
  for (std::size_t y = 0; y < kStateCount; ++y) {
    const Rational difference = after[y] - Rational(pi[y]) / total;
    error = std::max<Rational>(error, boost::multiprecision::abs(difference));
  }
  return error;
}

template <typename Rules = HintsRules>
Rational Error(const TableTarget& target, Order order, int node = 0) {
  return LargestDifference(AfterAStep<Rules>(target, order, node), target.density[static_cast<std::size_t>(node)]);
}

Table operator*(const Table& a, const Table& b) { return {a[0] * b[0], a[1] * b[1], a[2] * b[2]}; }

constexpr std::array<Table, 4> kLeaf = {{{1, 2, 5}, {3, 1, 2}, {1, 4, 1}, {2, 3, 1}}};

// The factors of the leaves, shared out in the order given, and a prior of which each leaf has a quarter.
TableTarget ProductTarget(const std::array<std::size_t, 4>& factor_of_leaf = {0, 1, 2, 3}) {
  const Table quarter = {2, 1, 3};
  std::array<Table, 4> leaf;
  for (std::size_t i = 0; i < 4; ++i) leaf[i] = kLeaf[factor_of_leaf[i]] * quarter;
  const Table left = leaf[0] * leaf[1];
  const Table right = leaf[2] * leaf[3];
  return {{left * right, left, right, leaf[0], leaf[1], leaf[2], leaf[3]}, factor_of_leaf};
}

// Leaves at temperature 2: each leaf's density is the square root of its factor of the parent.
TableTarget TemperedTarget() {
  const Table left = kLeaf[0] * kLeaf[0] * kLeaf[1] * kLeaf[1];
  const Table right = kLeaf[2] * kLeaf[2] * kLeaf[3] * kLeaf[3];
  return {{left * right, left, right, kLeaf[0], kLeaf[1], kLeaf[2], kLeaf[3]}, {0, 1, 2, 3}};
}

// Below the root, densities that have nothing to do with it.
TableTarget UnrelatedTarget() { return {{{{7, 2, 5}, {1, 5, 2}, {3, 1, 4}, {2, 1, 1}, {1, 6, 2}, {5, 3, 1}, {1, 1, 2}}}, {0, 1, 2, 3}}; }

TEST(HintsKernelTest, RandomChildOrderIsExact) { EXPECT_EQ(Error(ProductTarget(), Order::kRandom), 0); }

// One level less: a palindrome of depth two visits sixteen leaves, which are too many sequences. What the parent of leaves does, the
// parent of parents does.
TEST(HintsKernelTest, PalindromicChildOrderIsExact) {
  EXPECT_EQ(Error(ProductTarget(), Order::kPalindrome, 1), 0);
  EXPECT_NE(Error(ProductTarget(), Order::kFixed, 1), 0) << "control: there without back";
}

TEST(HintsKernelTest, ChildrenDrawnWithReplacementAndASingleChildAreExact) {
  EXPECT_EQ(Error(ProductTarget(), Order::kWithReplacement), 0);
  EXPECT_EQ(Error(ProductTarget(), Order::kSingle), 0);
}

// The terms are dealt out to the leaves anew at every root step: then even a fixed order is exact, because the reversed one is as likely.
TEST(HintsKernelTest, LeavesReshuffledAtEveryRootStepAreExact) {
  std::array<std::size_t, 4> deal = {0, 1, 2, 3};
  Distribution after{};
  Rational largest = 0;
  do {
    const Distribution one = AfterAStep<HintsRules>(ProductTarget(deal), Order::kFixed, 0);
    for (std::size_t y = 0; y < kStateCount; ++y) after[y] += one[y] / 24;
    largest = std::max<Rational>(largest, LargestDifference(one, ProductTarget().density[0]));
  } while (std::next_permutation(deal.begin(), deal.end()));
  EXPECT_EQ(LargestDifference(after, ProductTarget().density[0]), 0);
  EXPECT_GT(largest, Rational(1, 1000)) << "control: each deal by itself is biased";
}

TEST(HintsKernelTest, TemperedLeavesAreExact) { EXPECT_EQ(Error(TemperedTarget(), Order::kRandom), 0); }

TEST(HintsKernelTest, AnyDensityBelowTheRootIsExact) { EXPECT_EQ(Error(UnrelatedTarget(), Order::kRandom), 0); }

// Negative controls: what must not be done, seen by the same enumeration.

TEST(HintsKernelTest, SeesTheBiasOfAFixedChildOrder) {
  const double error = Error(ProductTarget(), Order::kFixed).convert_to<double>();
  std::cout << "error " << error << "\n";
  EXPECT_GT(error, 1e-3);
}

TEST(HintsKernelTest, SeesTheBiasOfAMissingCorrectionTerm) {
  const double error = Error<NoCorrection>(ProductTarget(), Order::kRandom).convert_to<double>();
  std::cout << "error " << error << "\n";
  EXPECT_GT(error, 1e-3);
}

TEST(HintsKernelTest, SeesTheBiasOfStoppingAfterTheFirstAcceptance) {
  const double error = Error<StopsAfterFirstAcceptance>(ProductTarget(), Order::kRandom).convert_to<double>();
  std::cout << "error " << error << "\n";
  EXPECT_GT(error, 1e-3);
}

}  // namespace
}  // namespace trem
