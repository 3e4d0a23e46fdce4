#include "coordinator/scheduling/ready_queue.h"

namespace trem {
namespace {

// Descends to the left first. Only nodes on the path to `from` can be left without success after their subtree was found to hold a task
// that is small enough, so the cost is O(log n).
template <typename Node>
const ReadyKey* FindBelow(Node node, Node end, const ReadyKey& from, std::uint64_t memory_bytes_max) {
  if (node == end || node.get_metadata() > memory_bytes_max) return nullptr;
  const ReadyKey& key = **node;
  if (!(key < from)) {
    if (const ReadyKey* left = FindBelow<Node>(node.get_l_child(), end, from, memory_bytes_max)) return left;
    if (key.memory_bytes <= memory_bytes_max) return &key;
  }
  return FindBelow<Node>(node.get_r_child(), end, from, memory_bytes_max);
}

}  // namespace

const ReadyKey* ReadyQueue::FindFirst(const ReadyKey& from, std::uint64_t memory_bytes_max) const {
  return FindBelow(tree_.node_begin(), tree_.node_end(), from, memory_bytes_max);
}

}  // namespace trem
