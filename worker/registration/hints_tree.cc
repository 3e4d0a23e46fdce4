#include "worker/registration/hints_tree.h"

#include <algorithm>
#include <numeric>
#include <utility>

#include "mosaic/base/check.h"
#include "mosaic/base/rng.h"

namespace trem {
namespace {

std::vector<std::vector<int>> SplitInterleaved(const std::vector<int>& terms, int branching, Rng& rng) {
  std::vector<std::vector<int>> parts(static_cast<std::size_t>(branching));
  std::vector<int> order(parts.size());
  std::iota(order.begin(), order.end(), 0);
  for (std::size_t begin = 0; begin < terms.size(); begin += parts.size()) {
    for (std::size_t i = order.size(); i > 1; --i) std::swap(order[i - 1], order[rng.UniformIndex(static_cast<std::uint32_t>(i))]);
    const std::size_t end = std::min(begin + parts.size(), terms.size());
    for (std::size_t i = begin; i < end; ++i) parts[static_cast<std::size_t>(order[i - begin])].push_back(terms[i]);
  }
  return parts;
}

}  // namespace

HintsTree BuildHintsTree(int term_count, int levels, int branching, int leaf_size, std::uint64_t seed) {
  TREM_CHECK(term_count >= 1 && leaf_size >= 1);
  TREM_CHECK(levels >= 0 && levels <= 16);
  TREM_CHECK(branching >= 2 && branching <= kHintsBranchingMax);
  constexpr std::uint64_t kTreeStream = 0x74726565;
  Rng rng({seed, kTreeStream});

  HintsTree tree;
  for (int smallest = term_count / branching; tree.leaf_level < levels && smallest >= leaf_size; smallest /= branching) ++tree.leaf_level;
  tree.nodes.push_back({0, std::vector<int>(static_cast<std::size_t>(term_count)), {}});
  std::iota(tree.nodes[0].terms.begin(), tree.nodes[0].terms.end(), 0);
  // nodes grows while it is walked: breadth first, by index.
  for (std::size_t i = 0; i < tree.nodes.size(); ++i) {
    if (tree.nodes[i].level == tree.leaf_level) break;
    for (std::vector<int>& part : SplitInterleaved(tree.nodes[i].terms, branching, rng)) {
      tree.nodes[i].children.push_back(static_cast<int>(tree.nodes.size()));
      tree.nodes.push_back({tree.nodes[i].level + 1, std::move(part), {}});
    }
  }
  return tree;
}

}  // namespace trem
