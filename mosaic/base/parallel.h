#pragma once

#include <functional>
#include <memory>
#include <utility>
#include <vector>

namespace trem {

// Calls body(index, slot) once for every index in [0, count), on up to `threads` threads at once, and on no more than ThreadsMax(). No two
// calls that run at the same time have the same slot in [0, threads): scratch memory may be kept per slot. Which index runs where and when
// is not determined, so what a call writes must be its own and depend on `index` alone; then the result does not depend on `threads`. One
// thread: in order, here, until more are allowed.
void ForEachIndex(int threads, int count, const std::function<void(int index, int slot)>& body);

// A step that the items of a pipeline go through.
template <typename Item>
struct PipelineStep {
  enum class Order {
    kOneByOne,  // The items in the order in which they came, one at a time.
    kAtOnce,    // Several items at a time, in any order.
  };
  Order order;
  std::function<void(Item&)> run;
};

// Takes items from `next`, one at a time, until it gives none, and puts each through all the steps, in their order; returns when all have
// left. Steps of several items run at once, on up to `threads` threads and on no more than ThreadsMax(), which may change meanwhile; two
// steps kOneByOne may run at the same time, too, of different items. At most `items_max` items are under way. One thread: an item after the
// other, here. What a step throws is thrown here.
template <typename Item>
void ForEachItem(int threads, int items_max, const std::function<std::unique_ptr<Item>()>& next,
                 const std::vector<PipelineStep<Item>>& steps);

// How many processors this process may run on.
int ProcessorCount();
// How many threads of this process may compute at once; may change at any time, from any thread. At first as many as there are processors.
int ThreadsMax();
// Values below 1 count as 1, and there are never more than processors.
void SetThreadsMax(int threads);

namespace internal {

// An item and a step of any type.
using AnyItem = std::shared_ptr<void>;
struct AnyStep {
  bool one_by_one = true;
  std::function<void(void*)> run;
};
void RunPipeline(int threads, int items_max, const std::function<AnyItem()>& next, const std::vector<AnyStep>& steps);

}  // namespace internal

template <typename Item>
void ForEachItem(int threads, int items_max, const std::function<std::unique_ptr<Item>()>& next,
                 const std::vector<PipelineStep<Item>>& steps) {
  std::vector<internal::AnyStep> any_steps;
  for (const PipelineStep<Item>& step : steps) {
    any_steps.push_back({step.order == PipelineStep<Item>::Order::kOneByOne, [&step](void* item) { step.run(*static_cast<Item*>(item)); }});
  }
  internal::RunPipeline(
      threads, items_max, [&next]() -> internal::AnyItem { return next(); }, any_steps);
}

}  // namespace trem
