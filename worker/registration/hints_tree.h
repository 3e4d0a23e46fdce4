#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace trem {

// A tree of nested subsets of the terms 0 .. term_count-1. Node 0 is the root and holds every term; the children of a node partition it;
// all leaves are at the same level. Parents stand before their children.
struct HintsTree {
  struct Node {
    int level = 0;              // Root: 0.
    std::vector<int> terms;     // Ascending, so that an evaluation walks through memory in one direction.
    std::vector<int> children;  // Node indices; empty: a leaf.
  };
  std::vector<Node> nodes;
  int leaf_level = 0;

  bool is_leaf(int node) const { return nodes[static_cast<std::size_t>(node)].children.empty(); }
  int term_count() const { return static_cast<int>(nodes.front().terms.size()); }
};

// Splits the terms into interleaved subsets. Each run of `branching` successive terms of a node gives one term to each child, in an order
// drawn from the seed: every subset is spread over all terms as a coset is, but none falls into step with the rows of an image.
// Interleaving matters: a leaf that were a block of neighbouring pixels would see one edge only, and its posterior would be far wider
// than its share of the data allows.
//
// At most `levels` levels below the root, fewer when a leaf would hold less than `leaf_size` terms.
// Preconditions: term_count >= 1, 0 <= levels <= 16, 2 <= branching <= kHintsBranchingMax, leaf_size >= 1.
HintsTree BuildHintsTree(int term_count, int levels, int branching, int leaf_size, std::uint64_t seed);

inline constexpr int kHintsBranchingMax = 16;

}  // namespace trem
