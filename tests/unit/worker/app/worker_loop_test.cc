// Goal: the worker's side of the control lane: nothing is computed twice without need, no result is lost, cancelling and leaving work, and
// a coordinator that restarts learns what is held. Method: RunWorkerLoop on a thread of its own with a task function of the test, driven by
// a real RouterChannel over ipc that plays the coordinator and decides what to answer, to lose and to repeat.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <functional>
#include <limits>
#include <mutex>
#include <string>
#include <thread>
#include <vector>
#include <zmq.hpp>

#include "tests/unit/worker/app/worker_loop_harness.h"

namespace trem {
namespace {

using std::chrono::milliseconds;
using ::testing::HasSubstr;

TEST(WorkerLoop, IntroducesItselfUntilWelcomed) {
  Harness harness;
  harness.options().memory_bytes_max = 123;
  harness.StartWorker(UntilCancelled);
  for (int i = 0; i < 3; ++i) {
    const v1::Hello hello = harness.Await(v1::Envelope::kHello).hello();
    EXPECT_EQ(hello.worker_id(), "worker-1");
    EXPECT_EQ(hello.protocol_version(), kProtocolVersion);
    EXPECT_EQ(hello.engine_revision(), kEngineRevision);
    EXPECT_EQ(hello.credit(), 1u);
    EXPECT_EQ(hello.memory_bytes_max(), 123u);
    EXPECT_EQ(hello.running_size(), 0);
  }
  harness.Welcome();
  harness.Await(v1::Envelope::kHeartbeat);
  EXPECT_TRUE(harness.Stop().ok());
}

TEST(WorkerLoop, SendsWhatATaskWroteToStderrWhileItRunsAndAtItsEnd) {
  Harness harness;
  AttemptLog log;
  harness.options().log = &log;
  harness.options().log_interval = milliseconds(10);
  std::atomic<bool> may_end{false};
  harness.StartWorker([&](const v1::TaskSpec& spec, const auto& progress) -> Result<v1::TaskResult> {
    log.Add("first\n");
    while (!may_end && progress(0.5)) std::this_thread::sleep_for(milliseconds(1));
    log.Add("last");
    return ResultOf(spec);
  });
  harness.Welcome();
  harness.Dispatch(kKeyA, 3);
  const v1::TaskLog running = harness.Await(v1::Envelope::kTaskLog).task_log();
  EXPECT_EQ(running.attempt().task_key(), kKeyA);
  EXPECT_EQ(running.attempt().attempt(), 3u);
  EXPECT_THAT(running.lines(), ::testing::ElementsAre("first"));
  may_end = true;
  EXPECT_THAT(harness.Await(v1::Envelope::kTaskLog).task_log().lines(), ::testing::ElementsAre("last"));
  EXPECT_TRUE(harness.Stop().ok());
}

TEST(WorkerLoop, ComputesATaskAndKeepsTheResultUntilTheAck) {
  Harness harness;
  std::atomic<int> runs{0};
  harness.StartWorker([&](const v1::TaskSpec& spec, const auto& progress) -> Result<v1::TaskResult> {
    ++runs;
    EXPECT_TRUE(progress(0.25));
    return ResultOf(spec);
  });
  harness.Welcome();
  harness.Dispatch(kKeyA, 1);
  const v1::Done first = harness.AwaitDone();
  EXPECT_ATTEMPT(first.attempt(), kKeyA, 1);
  EXPECT_EQ(first.status_code(), 0u);
  EXPECT_EQ(first.result().outputs(0).sha256(), kKeyA);
  EXPECT_GT(first.peak_memory_bytes(), 0u);
  // The Ack is lost: the same Done comes again, and a repeated Dispatch does not compute again.
  harness.Dispatch(kKeyA, 1);
  const v1::Done second = harness.AwaitDone();
  EXPECT_EQ(second.SerializeAsString(), first.SerializeAsString());
  // The next task waits for the Ack.
  harness.Dispatch(kKeyB, 1);
  EXPECT_ATTEMPT(harness.AwaitDone().attempt(), kKeyA, 1);
  EXPECT_EQ(runs, 1);
  harness.Ack(first.attempt());
  v1::Done done = harness.AwaitDone();
  while (done.attempt().task_key() == kKeyA) done = harness.AwaitDone();  // On its way before the Ack.
  EXPECT_ATTEMPT(done.attempt(), kKeyB, 1);
  harness.Ack(done.attempt());
  EXPECT_TRUE(harness.Stop().ok());
  EXPECT_EQ(runs, 2);
}

TEST(WorkerLoop, ReportsProgressOfTheRunningAttempt) {
  Harness harness;
  std::atomic<bool> finish{false};
  harness.StartWorker([&](const v1::TaskSpec& spec, const auto& progress) -> Result<v1::TaskResult> {
    while (!finish) {
      progress(std::numeric_limits<double>::quiet_NaN());
      progress(7.0);  // Out of range: told as 1.
      std::this_thread::sleep_for(milliseconds(1));
    }
    return ResultOf(spec);
  });
  harness.Welcome();
  harness.Dispatch(kKeyA, 5);
  double largest = 0.0;
  for (int i = 0; i < 50 && largest < 1.0; ++i) {
    const v1::Progress progress = harness.Await(v1::Envelope::kProgress).progress();
    EXPECT_ATTEMPT(progress.attempt(), kKeyA, 5);
    largest = std::max(largest, progress.fraction());
  }
  EXPECT_EQ(largest, 1.0);
  finish = true;
  harness.Ack(harness.AwaitDone().attempt());
  EXPECT_TRUE(harness.Stop().ok());
}

TEST(WorkerLoop, PassesTheProcessorsOnThatItIsLentAndEveryTaskBeginsWithOne) {
  Harness harness;
  std::mutex mutex;
  std::vector<int> shares;
  harness.options().on_share = [&](int processors) {
    const std::lock_guard lock(mutex);
    shares.push_back(processors);
  };
  harness.StartWorker(UntilCancelled);
  harness.Welcome();
  const auto share = [&](const v1::TaskAttempt& attempt, std::uint32_t processors) {
    v1::Envelope envelope;
    *envelope.mutable_share()->mutable_attempt() = attempt;
    envelope.mutable_share()->set_processors(processors);
    harness.Send(envelope);
  };
  harness.Dispatch(kKeyA, 1);
  share(Attempt(kKeyB, 1), 7);  // Not what runs.
  share(Attempt(kKeyA, 1), 3);
  harness.Cancel(Attempt(kKeyA, 1));
  harness.Ack(harness.AwaitDone().attempt());
  harness.Dispatch(kKeyA, 2);
  harness.Await(v1::Envelope::kProgress);
  EXPECT_TRUE(harness.Stop().ok());
  EXPECT_EQ(shares, (std::vector<int>{1, 3, 1}));
}

TEST(WorkerLoop, TellsWhyATaskFailed) {
  Harness harness;
  harness.StartWorker([](const v1::TaskSpec&, const auto&) -> Result<v1::TaskResult> {
    return InvalidInput("frame caf\xe9.png is not an image " + std::string(100000, '.'));
  });
  harness.Welcome();
  harness.Dispatch(kKeyA, 1);
  const v1::Done done = harness.AwaitDone();
  EXPECT_EQ(done.status_code(), static_cast<unsigned>(StatusCode::kInvalidInput));
  EXPECT_THAT(done.message(), HasSubstr("frame caf\xef\xbf\xbd.png is not an image"));
  EXPECT_FALSE(done.has_result());
  harness.Ack(done.attempt());
  EXPECT_TRUE(harness.Stop().ok());
}

TEST(WorkerLoop, TurnsAResultThatBreaksTheContractIntoAFailure) {
  Harness harness;
  harness.StartWorker([](const v1::TaskSpec& spec, const auto&) -> Result<v1::TaskResult> {
    v1::TaskResult result = ResultOf(spec);
    result.mutable_ingest()->set_median_motion_px(std::numeric_limits<double>::quiet_NaN());
    return result;
  });
  harness.Welcome();
  harness.Dispatch(kKeyA, 1);
  const v1::Done done = harness.AwaitDone();
  EXPECT_EQ(done.status_code(), static_cast<unsigned>(StatusCode::kFailed));
  EXPECT_THAT(done.message(), HasSubstr("median_motion_px is nan"));
  EXPECT_TRUE(harness.Stop().ok());
}

TEST(WorkerLoop, CancelsARunningTask) {
  Harness harness;
  harness.StartWorker(UntilCancelled);
  harness.Welcome();
  harness.Dispatch(kKeyA, 1);
  harness.Await(v1::Envelope::kProgress);
  harness.Cancel(Attempt(kKeyA, 2));  // Another attempt: not meant.
  EXPECT_ATTEMPT(harness.AwaitDone().attempt(), kKeyA, 2);
  harness.Await(v1::Envelope::kProgress);
  harness.Cancel(Attempt(kKeyA, 1));
  const v1::Done done = harness.AwaitDone();
  EXPECT_ATTEMPT(done.attempt(), kKeyA, 1);
  EXPECT_EQ(done.status_code(), static_cast<unsigned>(StatusCode::kCancelled));
  EXPECT_TRUE(harness.Stop().ok());
}

TEST(WorkerLoop, ANewerAttemptReplacesTheOlderOne) {
  Harness harness;
  std::atomic<int> runs{0};
  harness.StartWorker([&](const v1::TaskSpec& spec, const auto& progress) -> Result<v1::TaskResult> {
    if (++runs == 1) return UntilCancelled(spec, progress);
    return ResultOf(spec);
  });
  harness.Welcome();
  harness.Dispatch(kKeyA, 1);
  harness.Await(v1::Envelope::kProgress);
  harness.Dispatch(kKeyA, 2);
  v1::Done done = harness.AwaitDone();
  EXPECT_ATTEMPT(done.attempt(), kKeyA, 2);
  EXPECT_EQ(done.status_code(), 0u);
  // A finished result serves for a newer attempt without computing again.
  harness.Dispatch(kKeyA, 3);
  while (done.attempt().attempt() == 2) done = harness.AwaitDone();
  EXPECT_ATTEMPT(done.attempt(), kKeyA, 3);
  EXPECT_EQ(runs, 2);
  harness.Ack(done.attempt());
  EXPECT_TRUE(harness.Stop().ok());
}

TEST(WorkerLoop, TellsARestartedCoordinatorWhatItHolds) {
  Harness harness;
  std::atomic<bool> finish{false};
  std::atomic<int> runs{0};
  harness.StartWorker([&](const v1::TaskSpec& spec, const auto& progress) -> Result<v1::TaskResult> {
    ++runs;
    while (!finish && progress(0.5)) std::this_thread::sleep_for(milliseconds(1));
    return ResultOf(spec);
  });
  harness.Welcome();
  harness.Dispatch(kKeyA, 4);
  harness.Await(v1::Envelope::kProgress);
  harness.StopCoordinator();
  harness.StartCoordinator();
  v1::Hello hello = harness.Await(v1::Envelope::kHello).hello();
  ASSERT_EQ(hello.running_size(), 1);
  EXPECT_ATTEMPT(hello.running(0), kKeyA, 4);
  harness.Welcome();
  harness.Await(v1::Envelope::kProgress);
  finish = true;
  EXPECT_ATTEMPT(harness.AwaitDone().attempt(), kKeyA, 4);
  // Restarted again before the Ack: the result is still held, and sent again.
  harness.StopCoordinator();
  harness.StartCoordinator();
  hello = harness.Await(v1::Envelope::kHello).hello();
  ASSERT_EQ(hello.running_size(), 1);
  harness.Welcome();
  const v1::Done done = harness.AwaitDone();
  EXPECT_ATTEMPT(done.attempt(), kKeyA, 4);
  harness.Ack(done.attempt());
  EXPECT_TRUE(harness.Stop().ok());
  EXPECT_EQ(runs, 1);
}

TEST(WorkerLoop, SaysHelloAgainWhenTheCoordinatorDoesNotKnowIt) {
  Harness harness;
  harness.StartWorker(UntilCancelled);
  harness.Welcome();
  harness.Dispatch(kKeyA, 1);
  harness.Await(v1::Envelope::kProgress);
  v1::Envelope unknown;
  unknown.mutable_error()->set_status_code(static_cast<unsigned>(StatusCode::kUnavailable));
  unknown.mutable_error()->set_message("say Hello");
  harness.Send(unknown);
  EXPECT_EQ(harness.Await(v1::Envelope::kHello).hello().running_size(), 1);
  EXPECT_TRUE(harness.Stop().ok());
}

TEST(WorkerLoop, EndsWhenItIsRefused) {
  Harness harness;
  harness.StartWorker(UntilCancelled);
  harness.Await(v1::Envelope::kHello);
  v1::Envelope refusal;
  refusal.mutable_error()->set_status_code(static_cast<unsigned>(StatusCode::kInvalidInput));
  refusal.mutable_error()->set_message("engine revision 0, expected 1");
  harness.Send(refusal);
  const Status status = harness.Join();
  EXPECT_EQ(status.code(), StatusCode::kInvalidInput);
  EXPECT_EQ(status.message(), "the coordinator refused this worker: engine revision 0, expected 1");
}

TEST(WorkerLoop, EndsInWordsWhenTheCoordinatorSpeaksAnotherProtocolVersion) {
  Harness harness;
  harness.StopCoordinator();
  zmq::context_t context;
  zmq::socket_t router(context, zmq::socket_type::router);
  router.set(zmq::sockopt::linger, 0);
  router.set(zmq::sockopt::rcvtimeo, 10000);
  router.bind(harness.endpoint());
  harness.StartWorker(UntilCancelled);
  zmq::message_t peer;
  ASSERT_TRUE(router.recv(peer));
  router.send(peer, zmq::send_flags::sndmore);
  router.send(zmq::buffer(std::string("TREM\x09\0\0\0", 8)), zmq::send_flags::sndmore);
  router.send(zmq::buffer(std::string("whatever")), zmq::send_flags::none);
  const Status status = harness.Join();
  EXPECT_EQ(status.code(), StatusCode::kInvalidInput);
  EXPECT_THAT(status.message(), HasSubstr("the peer speaks protocol version 9, this program version 2"));
}

TEST(WorkerLoop, GivesUpWhenNoCoordinatorAnswers) {
  Harness harness;
  harness.StopCoordinator();
  harness.options().give_up = milliseconds(300);
  harness.StartWorker(UntilCancelled);
  EXPECT_EQ(harness.Join().code(), StatusCode::kUnavailable);
}

}  // namespace
}  // namespace trem
