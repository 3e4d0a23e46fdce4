// Goal: a loop does every index once, however many threads it is given, and never computes on more than the process may use; a pipeline
// does the same with its items, and what is to be done in order is. Method: loops that count themselves under limits that change.
#include "mosaic/base/parallel.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <functional>
#include <memory>
#include <stdexcept>
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

struct Number {
  int value = 0;
  int squared = 0;
};
using Step = PipelineStep<Number>;

// Squares 0 .. count - 1 and gives the squares in the order in which the last step saw them; `on_square` is called within the step at once.
std::vector<int> Squares(int threads, int count, const std::function<void(int)>& on_square) {
  std::vector<int> squares, accepted;
  int given = 0;
  ForEachItem<Number>(threads, 8,
                      [&] {
                        return given < count ? std::make_unique<Number>(Number{given++, 0}) : nullptr;
                      },
                      {{Step::Order::kAtOnce,
                        [&](Number& number) {
                          on_square(number.value);
                          number.squared = number.value * number.value;
                        }},
                       {Step::Order::kOneByOne, [&](Number& number) { accepted.push_back(number.value); }},
                       {Step::Order::kAtOnce, [](Number& number) { number.squared += 1; }},
                       {Step::Order::kOneByOne, [&](Number& number) { squares.push_back(number.squared - 1); }}});
  EXPECT_TRUE(std::is_sorted(accepted.begin(), accepted.end()));
  EXPECT_EQ(accepted.size(), static_cast<std::size_t>(count));
  return squares;
}

TEST_F(Parallel, APipelineKeepsTheOrderOfItsItemsForAnyNumberOfThreads) {
  for (const int threads : {0, 1, 2, 3, 16}) {
    const std::vector<int> squares = Squares(threads, 500, [](int value) {
      if (value % 7 == 0) std::this_thread::sleep_for(std::chrono::microseconds(200));  // Others overtake it.
    });
    ASSERT_EQ(squares.size(), 500U) << threads;
    for (int i = 0; i < 500; ++i) ASSERT_EQ(squares[static_cast<std::size_t>(i)], i * i) << threads;
  }
}

TEST_F(Parallel, APipelineTakesUpALimitThatChanges) {
  std::atomic<int> running{0}, most{0}, most_late{0};
  SetThreadsMax(1);
  const std::vector<int> squares = Squares(8, 300, [&](int value) {
    const int now = ++running;
    if (value < 100) most = std::max(most.load(), now);
    if (value > 200) most_late = std::max(most_late.load(), now);
    if (value == 100) SetThreadsMax(2);
    if (value == 150) SetThreadsMax(1);
    std::this_thread::sleep_for(std::chrono::microseconds(100));
    --running;
  });
  EXPECT_EQ(squares.size(), 300U);
  EXPECT_EQ(most, 1);
  EXPECT_EQ(most_late, 1);  // Those under way when the limit sank have left by then: there are at most 8.
}

TEST_F(Parallel, WhatAStepOfAPipelineThrowsReachesTheCaller) {
  for (const int threads : {1, 3}) {
    EXPECT_THROW(Squares(threads, 50,
                         [](int value) {
                           if (value == 20) throw std::runtime_error("twenty");
                         }),
                 std::runtime_error)
        << threads;
  }
}

}  // namespace
}  // namespace trem
