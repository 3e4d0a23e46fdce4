#include "worker/sensor/parallel.h"

#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <map>
#include <mutex>

namespace trem {
namespace {

// Kept for the life of the process: making one costs more than many loops take.
tbb::task_arena& ArenaOf(int threads) {
  static std::mutex mutex;
  static std::map<int, tbb::task_arena> arenas;
  const std::lock_guard<std::mutex> lock(mutex);
  return arenas.try_emplace(threads, threads).first->second;
}

}  // namespace

void ForEachIndex(int threads, int count, const std::function<void(int index, int slot)>& body) {
  if (threads <= 1 || count <= 1) {
    for (int index = 0; index < count; ++index) body(index, 0);
    return;
  }
  ArenaOf(std::min(threads, tbb::info::default_concurrency())).execute([&] {
    tbb::parallel_for(
        tbb::blocked_range<int>(0, count, 1),
        [&](const tbb::blocked_range<int>& range) {
          for (int index = range.begin(); index < range.end(); ++index) body(index, tbb::this_task_arena::current_thread_index());
        },
        tbb::simple_partitioner());
  });
}

}  // namespace trem
