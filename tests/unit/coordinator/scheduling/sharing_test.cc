// Goal: processors of workers that have nothing to do are lent to what runs beside them, and given back as soon as they have something.
// Method: the scheduler alone; the shares it tells are read from its effects.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>
#include <string>

#include "mosaic/base/check.h"
#include "tests/unit/coordinator/scheduling/fake_tasks.h"

namespace trem::testing {
namespace {

using ::testing::IsEmpty;
using ::testing::SizeIs;

DispatchEffect OnlyDispatch(const std::vector<Effect>& effects) {
  const auto dispatches = Only<DispatchEffect>(effects);
  TREM_CHECK(dispatches.size() == 1);
  return dispatches[0];
}

// What was told last, by worker.
std::map<std::string, std::uint32_t> Told(const std::vector<Effect>& effects) {
  std::map<std::string, std::uint32_t> told;
  for (const ShareEffect& share : Only<ShareEffect>(effects)) told[share.worker_id] = share.processors;
  return told;
}

using Shares = std::map<std::string, std::uint32_t>;

TEST(SharingTest, ATaskAloneOnItsHostGetsTheProcessorsOfIdleWorkersThereAsTheyCome) {
  Bench bench;
  const std::vector<Effect> first = bench.Hello("w1", {}, 1, 0, "a");
  EXPECT_THAT(Only<ShareEffect>(first), IsEmpty());
  const DispatchEffect ingest = OnlyDispatch(bench.Submit("job"));
  const std::vector<Effect> second = bench.Hello("w2", {}, 1, 0, "a");
  ASSERT_THAT(Only<ShareEffect>(second), SizeIs(1));
  EXPECT_EQ(Only<ShareEffect>(second)[0].attempt, AttemptOf(ingest));
  EXPECT_EQ(Told(second), (Shares{{"w1", 2}}));
  EXPECT_EQ(Told(bench.Hello("w3", {}, 1, 0, "a")), (Shares{{"w1", 3}}));
  EXPECT_THAT(Only<ShareEffect>(bench.Hello("w4", {}, 1, 0, "b")), IsEmpty()) << "another host's processors are of no use";
  EXPECT_THAT(Only<ShareEffect>(bench.Progress(ingest)), IsEmpty()) << "told once";
}

TEST(SharingTest, NothingIsLentWhileEveryWorkerHasATask) {
  Bench bench;
  bench.Hello("w1", {}, 1, 0, "a");
  const DispatchEffect ingest = OnlyDispatch(bench.Submit("job"));
  EXPECT_EQ(Told(bench.Hello("w2", {}, 1, 0, "a")), (Shares{{"w1", 2}}));
  const std::vector<Effect> unfolded = bench.Done(ingest);
  ASSERT_THAT(Only<DispatchEffect>(unfolded), SizeIs(2));
  EXPECT_THAT(Only<ShareEffect>(unfolded), IsEmpty()) << "an attempt begins with one";
}

TEST(SharingTest, WhatWasLentIsGivenBackWhenItsWorkerGetsATask) {
  Bench bench;
  bench.Hello("w1", {}, 1, 0, "a");
  bench.Submit("job");
  bench.Hello("w2", {}, 1, 0, "a");
  const std::vector<Effect> other = bench.Submit("other", "another leg");
  ASSERT_THAT(Only<DispatchEffect>(other), SizeIs(1));
  EXPECT_EQ(Told(other), (Shares{{"w1", 1}}));
  EXPECT_EQ(Told(bench.Step(WorkerLostEvent{"w2"})), Shares{}) << "nobody is idle on the host";
}

TEST(SharingTest, SeveralTasksShareEvenlyAndADrainingWorkerLendsNothing) {
  Bench bench;
  bench.Hello("w1", {}, 1, 0, "a");
  bench.Hello("w2", {}, 1, 0, "a");
  bench.Submit("one", "one");
  EXPECT_EQ(Told(bench.Submit("two", "two")), (Shares{{"w1", 1}}));
  EXPECT_EQ(Told(bench.Hello("w3", {}, 1, 0, "a")), Shares{}) << "one processor for two tasks";
  EXPECT_EQ(Told(bench.Hello("w4", {}, 1, 0, "a")), (Shares{{"w1", 2}, {"w2", 2}}));
  EXPECT_EQ(Told(bench.Step(DrainWorkerEvent{"w4"})), (Shares{{"w1", 1}, {"w2", 1}}));
}

TEST(SharingTest, AWorkerThatSaysHelloAgainIsToldAgain) {
  Bench bench;
  bench.Hello("w1", {}, 1, 0, "a");
  const DispatchEffect ingest = OnlyDispatch(bench.Submit("job"));
  bench.Hello("w2", {}, 1, 0, "a");
  EXPECT_EQ(Told(bench.Hello("w1", {AttemptOf(ingest)}, 1, 0, "a")), (Shares{{"w1", 2}}));
  bench.Restart();
  EXPECT_EQ(Told(bench.Hello("w1", {AttemptOf(ingest)}, 1, 0, "a")), Shares{});
  EXPECT_EQ(Told(bench.Hello("w2", {}, 1, 0, "a")), (Shares{{"w1", 2}}));
}

}  // namespace
}  // namespace trem::testing
