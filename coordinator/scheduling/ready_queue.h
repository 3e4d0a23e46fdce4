#pragma once

#include <cstdint>
#include <ext/pb_ds/assoc_container.hpp>
#include <functional>
#include <tuple>

namespace trem {

// Number of a task in the scheduler's table.
using TaskIndex = std::uint32_t;

// A ready task, ordered by where its work comes: job, stage, then tasks that read the same frames or scenes side by side.
struct ReadyKey {
  std::uint64_t job = 0;
  int kind = 0;
  std::uint32_t locality = 0;
  std::uint32_t index = 0;
  TaskIndex task = 0;
  std::uint64_t memory_bytes = 0;  // Not part of the order.

  friend bool operator<(const ReadyKey& a, const ReadyKey& b) {
    return std::tie(a.job, a.kind, a.locality, a.index, a.task) < std::tie(b.job, b.kind, b.locality, b.index, b.task);
  }
  bool SameGroup(const ReadyKey& other) const { return SameStage(other) && locality == other.locality; }
  bool SameStage(const ReadyKey& other) const { return job == other.job && kind == other.kind; }
};

// Keeps in every node of a search tree the least memory that a task below it needs.
template <typename NodeConstIterator, typename NodeIterator, typename Compare, typename Allocator>
class LeastMemoryUpdate {
 public:
  using metadata_type = std::uint64_t;
  void operator()(NodeIterator node, NodeConstIterator end) const {
    std::uint64_t least = (**node).memory_bytes;
    for (const NodeConstIterator child : {NodeConstIterator(node.get_l_child()), NodeConstIterator(node.get_r_child())}) {
      if (child != end && child.get_metadata() < least) least = child.get_metadata();
    }
    const_cast<metadata_type&>(node.get_metadata()) = least;
  }

 protected:
  virtual ~LeastMemoryUpdate() = default;
};

// Ready tasks in order of work, searchable by what memory they need. Every call costs O(log n).
class ReadyQueue {
 public:
  void Insert(const ReadyKey& key) { tree_.insert(key); }
  bool Erase(const ReadyKey& key) { return tree_.erase(key); }
  bool empty() const { return tree_.empty(); }
  // The first task that does not stand before `from` and needs at most `memory_bytes_max`; null when there is none.
  const ReadyKey* FindFirst(const ReadyKey& from, std::uint64_t memory_bytes_max) const;

 private:
  using Tree = __gnu_pbds::tree<ReadyKey, __gnu_pbds::null_type, std::less<ReadyKey>, __gnu_pbds::rb_tree_tag, LeastMemoryUpdate>;
  Tree tree_;
};

}  // namespace trem
