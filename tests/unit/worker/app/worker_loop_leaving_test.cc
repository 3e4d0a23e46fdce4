// Goal: a worker that is stopped, drained or stuck leaves in order: what it has finished is delivered, what runs is finished within the
// grace or handed back, and a task that does not stop does not hold it. Method: as in worker_loop_test.cc.
#include <gtest/gtest.h>
#include <stdlib.h>

#include <atomic>
#include <chrono>
#include <filesystem>
#include <functional>
#include <string>
#include <thread>

#include "tests/support/paths.h"
#include "tests/unit/worker/app/worker_loop_harness.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;

// A task that goes on until it is told to finish, or cancelled.
ComputeThread::Task Until(const std::atomic<bool>& finish) {
  return [&finish](const v1::TaskSpec& spec, const auto& progress) -> Result<v1::TaskResult> {
    while (!finish && progress(0.5)) std::this_thread::sleep_for(milliseconds(1));
    return ResultOf(spec);
  };
}

// The worker takes nothing more: what it is given it hands back.
void ExpectRefusal(Harness& harness) {
  harness.Dispatch(kKeyB, 1);
  const v1::Done refused = harness.AwaitDone();
  EXPECT_ATTEMPT(refused.attempt(), kKeyB, 1);
  EXPECT_EQ(refused.status_code(), static_cast<unsigned>(StatusCode::kCancelled)) << "it takes nothing more";
}

TEST(WorkerLoopLeaving, CancelsAndSaysGoodbyeWhenStopped) {
  Harness harness;
  std::atomic<bool> was_cancelled{false};
  harness.StartWorker([&](const v1::TaskSpec& spec, const auto& progress) -> Result<v1::TaskResult> {
    auto result = UntilCancelled(spec, progress);
    was_cancelled = true;
    return result;
  });
  harness.Welcome();
  harness.Dispatch(kKeyA, 1);
  harness.Await(v1::Envelope::kProgress);
  harness.RequestStop();
  harness.Await(v1::Envelope::kGoodbye);
  EXPECT_TRUE(harness.Join().ok());
  EXPECT_TRUE(was_cancelled);
}

TEST(WorkerLoopLeaving, DeliversAFinishedResultBeforeItLeaves) {
  Harness harness;
  harness.options().drain_ack_wait = std::chrono::seconds(10);
  harness.StartWorker([](const v1::TaskSpec& spec, const auto&) -> Result<v1::TaskResult> { return ResultOf(spec); });
  harness.Welcome();
  harness.Dispatch(kKeyA, 1);
  harness.AwaitDone();
  harness.RequestStop();
  harness.Ack(harness.AwaitDone().attempt());
  harness.Await(v1::Envelope::kGoodbye);
  EXPECT_TRUE(harness.Join().ok());
}

TEST(WorkerLoopLeaving, LetsTheRunningTaskFinishWithinTheGraceWhenStopped) {
  Harness harness;
  harness.options().drain_grace = std::chrono::minutes(10);
  harness.options().drain_ack_wait = std::chrono::seconds(10);
  std::atomic<bool> finish{false};
  harness.StartWorker(Until(finish));
  harness.Welcome();
  harness.Dispatch(kKeyA, 1);
  harness.Await(v1::Envelope::kProgress);
  harness.RequestStop();
  ExpectRefusal(harness);
  harness.Await(v1::Envelope::kProgress);
  finish = true;
  const v1::Done done = harness.AwaitDone();
  EXPECT_ATTEMPT(done.attempt(), kKeyA, 1);
  EXPECT_EQ(done.status_code(), 0u);
  harness.Ack(done.attempt());
  harness.Await(v1::Envelope::kGoodbye);
  EXPECT_TRUE(harness.Join().ok());
}

TEST(WorkerLoopLeaving, HandsTheTaskBackWhenTheGraceIsOver) {
  Harness harness;
  harness.options().drain_grace = milliseconds(100);
  harness.StartWorker(UntilCancelled);
  harness.Welcome();
  harness.Dispatch(kKeyA, 1);
  harness.Await(v1::Envelope::kProgress);
  harness.RequestStop();
  harness.Await(v1::Envelope::kGoodbye);
  EXPECT_TRUE(harness.Join().ok());
}

TEST(WorkerLoopLeaving, LeavesByItselfOnceDrained) {
  Harness harness;
  std::atomic<bool> finish{false};
  harness.StartWorker(Until(finish));
  harness.Welcome();
  harness.Dispatch(kKeyA, 1);
  harness.Await(v1::Envelope::kProgress);
  v1::Envelope drain;
  drain.mutable_drain()->set_reason("maintenance");
  harness.Send(drain);
  // What it hands back shows that it has read the request, which a socket that closes might drop.
  ExpectRefusal(harness);
  harness.StopCoordinator();
  harness.StartCoordinator();
  EXPECT_EQ(harness.Await(v1::Envelope::kHello).hello().credit(), 0u) << "a restarted coordinator gives it nothing";
  harness.Welcome();
  finish = true;
  harness.Ack(harness.AwaitDone().attempt());
  harness.Await(v1::Envelope::kGoodbye);
  EXPECT_TRUE(harness.Join().ok());
}

TEST(WorkerLoopDeathTest, ExitsWhenACancelledTaskDoesNotStop) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  // The dying process can't remove its folder; it is made inside one that this process removes.
  const trem::testing::TempDir scratch;
  const std::string before = fs::temp_directory_path().string();
  ::setenv("TMPDIR", scratch.path().c_str(), 1);
  EXPECT_EXIT(
      {
        Harness harness;
        harness.options().cancel_grace = milliseconds(100);
        std::atomic<bool> for_ever{true};
        harness.StartWorker([&](const v1::TaskSpec& spec, const auto& progress) -> Result<v1::TaskResult> {
          progress(0.1);
          while (for_ever) std::this_thread::sleep_for(milliseconds(10));
          return ResultOf(spec);
        });
        harness.Welcome();
        harness.Dispatch(kKeyA, 1);
        harness.Await(v1::Envelope::kProgress);
        harness.Cancel(Attempt(kKeyA, 1));
        (void)harness.Join();
      },
      ::testing::ExitedWithCode(9), "");
  ::setenv("TMPDIR", before.c_str(), 1);
}

}  // namespace
}  // namespace trem
