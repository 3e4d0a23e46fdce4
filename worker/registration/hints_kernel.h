#pragma once

#include <array>
#include <cstddef>

#include "worker/registration/hints_tree.h"

namespace trem {

// What a node hands to its parent: where the chain is now, and by which factor the node's own density changed on the way.
template <typename State, typename Ratio>
struct HintsMove {
  State state;
  Ratio change{};  // F_n(state) / F_n(start); Ratio{} is one. One when nothing moved.
  bool moved = false;
};

// How a parent composes its children. The rules of the exact sampler; a test replaces them one by one to see that it notices.
struct HintsRules {
  // The correction term after a child changed its own density by `change`.
  template <typename Ratio>
  static Ratio Correction(const Ratio& correction, const Ratio& change) {
    return correction * change;
  }
  // Whether the next child runs.
  static bool GoesOn(bool /*moved*/) { return true; }
};

// Children visited in one parent step at most: a palindrome visits each twice.
inline constexpr int kHintsVisitsMax = 2 * kHintsBranchingMax;
using HintsOrder = std::array<int, static_cast<std::size_t>(kHintsVisitsMax)>;

// One step of HINTS (hierarchical importance with nested training samples; Strens, "Efficient hierarchical MCMC for policy search", ICML
// 2004) at `node`, from `x`. Leaves F_root invariant.
//
//   leaf    Metropolis-Hastings on F_leaf: y ~ q(.|x), accepted with min(1, F(y)/F(x) q(x|y)/q(y|x)); reports F(y)/F(x).
//   parent  runs its children one after the other, x -> y, C = product of the changes that they report; when nothing moved this is free;
//           else y is accepted with min(1, F_n(y)/F_n(x) / C); reports F_n(y)/F_n(x).
//
// Why it is exact: seen together with the reported changes, the children's sequence is reversible with respect to a density that C
// measures, provided that the reversed sequence is as likely as the sequence: the order must be random or a palindrome. Any density may
// stand at a node that is not the root.
//
// The number type is abstract so that the same code runs in the log domain of production and in exact rational arithmetic in tests:
//   Ratio                 a positive factor: Ratio{} is one, * and / compose.
//   Ratio target.Density(int node, const State&)                  F_node, up to a factor of the node.
//   State chooser.Propose(int leaf, const State& x, Ratio* q)     draws y; *q = q(x|y) / q(y|x).
//   int chooser.ChildOrder(int node, HintsOrder* order)           positions in node.children to visit; returns how many.
//   bool chooser.Accept(int node, const Ratio& ratio)             true with probability min(1, ratio).
template <typename Ratio, typename Rules = HintsRules, typename State, typename Target, typename Chooser>
HintsMove<State, Ratio> HintsStep(const HintsTree& tree, int node, const State& x, Target& target, Chooser& chooser) {
  if (tree.is_leaf(node)) {
    Ratio hastings{};
    State y = chooser.Propose(node, x, &hastings);
    const Ratio change = target.Density(node, y) / target.Density(node, x);
    if (!chooser.Accept(node, change * hastings)) return {x, Ratio{}, false};
    return {y, change, true};
  }
  HintsOrder order;
  const int visits = chooser.ChildOrder(node, &order);
  State y = x;
  Ratio correction{};
  bool moved = false;
  for (int i = 0; i < visits && Rules::GoesOn(moved); ++i) {
    const int child = tree.nodes[static_cast<std::size_t>(node)].children[static_cast<std::size_t>(order[static_cast<std::size_t>(i)])];
    HintsMove<State, Ratio> move = HintsStep<Ratio, Rules>(tree, child, y, target, chooser);
    if (!move.moved) continue;
    y = move.state;
    correction = Rules::Correction(correction, move.change);
    moved = true;
  }
  if (!moved) return {x, Ratio{}, false};
  const Ratio change = target.Density(node, y) / target.Density(node, x);
  if (!chooser.Accept(node, change / correction)) return {x, Ratio{}, false};
  return {y, change, true};
}

}  // namespace trem
