// Goal: a loop does every index once, however many threads it is given, and never computes on more than the process may use. Method: loops
// that count themselves under limits that change.
#include "mosaic/base/parallel.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <thread>
#include <vector>

namespace trem {
namespace {

// Puts the limit back where it was.
class Parallel : public ::testing::Test {
 protected:
  void TearDown() override { SetThreadsMax(ProcessorCount()); }
};

// The largest number of calls that ran at once.
int MostAtOnce(int threads, int count) {
  std::atomic<int> running{0}, most{0};
  ForEachIndex(threads, count, [&](int, int slot) {
    EXPECT_GE(slot, 0);
    EXPECT_LT(slot, threads);
    const int now = ++running;
    int seen = most;
    while (now > seen && !most.compare_exchange_weak(seen, now)) {
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
    --running;
  });
  return most;
}

TEST_F(Parallel, DoesEveryIndexOnceForAnyNumberOfThreads) {
  for (const int threads : {0, 1, 2, 3, 16}) {
    std::vector<std::atomic<int>> calls(1000);
    ForEachIndex(threads, 1000, [&](int index, int) { ++calls[static_cast<std::size_t>(index)]; });
    EXPECT_TRUE(std::all_of(calls.begin(), calls.end(), [](const std::atomic<int>& count) { return count == 1; })) << threads;
  }
}

TEST_F(Parallel, ComputesOnNoMoreThreadsThanTheProcessMay) {
  EXPECT_LE(MostAtOnce(8, 40), std::min(8, ProcessorCount()));
  SetThreadsMax(1);
  EXPECT_EQ(ThreadsMax(), 1);
  EXPECT_EQ(MostAtOnce(8, 40), 1);
  SetThreadsMax(2);
  EXPECT_LE(MostAtOnce(8, 40), 2);
  SetThreadsMax(-3);
  EXPECT_EQ(ThreadsMax(), 1);
}

}  // namespace
}  // namespace trem
