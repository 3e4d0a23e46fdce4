#include "mosaic/base/parallel.h"

#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_pipeline.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <limits>
#include <map>
#include <mutex>

namespace trem {
namespace {

std::atomic<int> threads_max{std::numeric_limits<int>::max()};

// Kept for the life of the process: making one costs more than many loops take.
tbb::task_arena& ArenaOf(int threads) {
  static std::mutex mutex;
  static std::map<int, tbb::task_arena> arenas;
  const std::lock_guard<std::mutex> lock(mutex);
  return arenas.try_emplace(threads, threads).first->second;
}

}  // namespace

int ProcessorCount() { return tbb::info::default_concurrency(); }

int ThreadsMax() { return std::min(threads_max.load(), ProcessorCount()); }

void SetThreadsMax(int threads) { threads_max = std::max(threads, 1); }

void ForEachIndex(int threads, int count, const std::function<void(int index, int slot)>& body) {
  int first = 0;
  // More threads may be allowed while a long loop goes on.
  for (; first < count && (threads <= 1 || count - first <= 1 || threads_max <= 1); ++first) body(first, 0);
  if (first == count) return;
  ArenaOf(std::min(threads, ThreadsMax())).execute([&] {
    tbb::parallel_for(
        tbb::blocked_range<int>(first, count, 1),
        [&](const tbb::blocked_range<int>& range) {
          for (int index = range.begin(); index < range.end(); ++index) body(index, tbb::this_task_arena::current_thread_index());
        },
        tbb::simple_partitioner());
  });
}

namespace internal {
namespace {

// Until there are no more items, or another number of threads is allowed. False: there are no more.
bool RunItemsAtOnce(int threads, int threads_wanted, int items_max, const std::function<AnyItem()>& next,
                    const std::vector<AnyStep>& steps) {
  bool goes_on = true;
  using tbb::filter_mode;
  tbb::filter<void, AnyItem> line = tbb::make_filter<void, AnyItem>(filter_mode::serial_in_order, [&](tbb::flow_control& control) {
    AnyItem item;
    if (std::min(threads_wanted, ThreadsMax()) == threads) {
      item = next();
      goes_on = item != nullptr;
    }
    if (item == nullptr) control.stop();
    return item;
  });
  for (const AnyStep& step : steps) {
    line = line & tbb::make_filter<AnyItem, AnyItem>(step.one_by_one ? filter_mode::serial_in_order : filter_mode::parallel,
                                                     [&step](const AnyItem& item) {
                                                       step.run(item.get());
                                                       return item;
                                                     });
  }
  const tbb::filter<void, void> whole = line & tbb::make_filter<AnyItem, void>(filter_mode::parallel, [](const AnyItem&) {});
  ArenaOf(threads).execute([&] { tbb::parallel_pipeline(static_cast<std::size_t>(std::max(items_max, 1)), whole); });
  return goes_on;
}

}  // namespace

void RunPipeline(int threads, int items_max, const std::function<AnyItem()>& next, const std::vector<AnyStep>& steps) {
  for (;;) {
    if (const int allowed = std::min(threads, ThreadsMax()); allowed > 1) {
      if (!RunItemsAtOnce(allowed, threads, items_max, next, steps)) return;
      continue;
    }
    const AnyItem item = next();
    if (item == nullptr) return;
    for (const AnyStep& step : steps) step.run(item.get());
  }
}

}  // namespace internal
}  // namespace trem
