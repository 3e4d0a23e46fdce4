#include "mosaic/base/parallel.h"

#include <tbb/info.h>
#include <tbb/parallel_for.h>
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

}  // namespace trem
