// Goal: the worker's side of the control lane: nothing is computed twice without need, no result is lost, cancelling and leaving work, and
// a coordinator that restarts learns what is held. Method: RunWorkerLoop on a thread of its own with a task function of the test, driven by
// a real RouterChannel over ipc that plays the coordinator and decides what to answer, to lose and to repeat.
#include "worker/app/worker_loop.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <stdlib.h>

#include <algorithm>
#include <atomic>
#include <filesystem>
#include <functional>
#include <limits>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <zmq.hpp>

#include "proto/channel/router_channel.h"
#include "tests/support/paths.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;
using ::testing::HasSubstr;

const std::string kKeyA(64, 'a');
const std::string kKeyB(64, 'b');

v1::TaskAttempt Attempt(const std::string& key, std::uint32_t number) {
  v1::TaskAttempt attempt;
  attempt.set_task_key(key);
  attempt.set_attempt(number);
  return attempt;
}

v1::TaskResult ResultOf(const v1::TaskSpec& spec) {
  v1::TaskResult result;
  v1::ArtefactRef* output = result.add_outputs();
  output->set_name("out");
  output->set_sha256(spec.key());
  return result;
}

// Works until it is cancelled.
Result<v1::TaskResult> UntilCancelled(const v1::TaskSpec&, const std::function<bool(double)>& progress) {
  while (progress(0.5)) std::this_thread::sleep_for(milliseconds(1));
  return Cancelled("stopped as asked");
}

class Harness {
 public:
  Harness() {
    std::string pattern = (fs::temp_directory_path() / "trem-loop-XXXXXX").string();
    TREM_CHECK(::mkdtemp(pattern.data()) != nullptr);
    folder_ = pattern;
    endpoint_ = "ipc://" + (folder_ / "socket").string();
    options_.worker_id = "worker-1";
    options_.host = "host";
    options_.hello_interval = milliseconds(100);
    options_.progress_interval = milliseconds(10);
    options_.done_resend = milliseconds(100);
    StartCoordinator();
  }
  ~Harness() {
    if (loop_.joinable()) (void)Stop();
    router_.reset();
    fs::remove_all(folder_);
  }

  WorkerOptions& options() { return options_; }
  const std::string& endpoint() const { return endpoint_; }

  void StartCoordinator() {
    auto router = RouterChannel::Bind(endpoint_);
    TREM_CHECK_MSG(router.ok(), router.status().message());
    router_ = std::move(router).value();
  }
  void StopCoordinator() {
    router_.reset();
    was_welcomed_ = false;
  }

  void StartWorker(ComputeThread::Task task) {
    auto channel = DealerChannel::Connect(endpoint_);
    TREM_CHECK_MSG(channel.ok(), channel.status().message());
    channel_ = std::move(channel).value();
    loop_ = std::thread([this, task = std::move(task)] { status_ = RunWorkerLoop(options_, channel_.get(), task, stop_); });
  }
  void RequestStop() {
    stop_ = true;
    channel_->Wake();
  }
  // The loop's status once it has ended.
  Status Join() {
    loop_.join();
    channel_.reset();
    return status_;
  }
  Status Stop() {
    RequestStop();
    return Join();
  }

  // The next message of kind `body`; others are skipped. Fails after about ten seconds.
  v1::Envelope Await(v1::Envelope::BodyCase body) {
    const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(10);
    while (std::chrono::steady_clock::now() < deadline) {
      auto incoming = router_->Poll(milliseconds(100));
      if (!incoming || !incoming->envelope.ok()) continue;
      peer_ = incoming->peer;
      if (incoming->envelope->body_case() == body) return *incoming->envelope;
      if (incoming->envelope->has_hello() && was_welcomed_) SendWelcome();  // The test was silent for too long.
    }
    ADD_FAILURE() << "no message of kind " << body << " came";
    return {};
  }
  void Send(const v1::Envelope& envelope) { EXPECT_TRUE(router_->Send(peer_, envelope)); }

  void Welcome() {
    Await(v1::Envelope::kHello);
    was_welcomed_ = true;
    SendWelcome();
  }
  void Dispatch(const std::string& key, std::uint32_t attempt) {
    v1::Envelope envelope;
    envelope.mutable_dispatch()->mutable_task()->set_key(key);
    envelope.mutable_dispatch()->mutable_task()->set_kind(v1::ENHANCE);
    envelope.mutable_dispatch()->set_attempt(attempt);
    envelope.mutable_dispatch()->set_lease_ms(10000);
    Send(envelope);
  }
  void Ack(const v1::TaskAttempt& attempt) {
    v1::Envelope envelope;
    *envelope.mutable_ack()->mutable_attempt() = attempt;
    Send(envelope);
  }
  void Cancel(const v1::TaskAttempt& attempt) {
    v1::Envelope envelope;
    *envelope.mutable_cancel_task()->mutable_attempt() = attempt;
    envelope.mutable_cancel_task()->set_reason("test");
    Send(envelope);
  }
  v1::Done AwaitDone() { return Await(v1::Envelope::kDone).done(); }

 private:
  void SendWelcome() {
    v1::Envelope envelope;
    envelope.mutable_welcome()->set_heartbeat_interval_ms(200);
    Send(envelope);
  }

  fs::path folder_;
  std::string endpoint_;
  WorkerOptions options_;
  std::unique_ptr<RouterChannel> router_;
  std::unique_ptr<DealerChannel> channel_;
  std::string peer_;
  bool was_welcomed_ = false;
  std::atomic<bool> stop_{false};
  std::thread loop_;
  Status status_;
};

#define EXPECT_ATTEMPT(attempt_message, key, number) \
  do {                                               \
    const v1::TaskAttempt told = (attempt_message);  \
    EXPECT_EQ(told.task_key(), key);                 \
    EXPECT_EQ(told.attempt(), number##u);            \
  } while (false)

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
  EXPECT_THAT(status.message(), HasSubstr("the peer speaks protocol version 9, this program version 1"));
}

TEST(WorkerLoop, GivesUpWhenNoCoordinatorAnswers) {
  Harness harness;
  harness.StopCoordinator();
  harness.options().give_up = milliseconds(300);
  harness.StartWorker(UntilCancelled);
  EXPECT_EQ(harness.Join().code(), StatusCode::kUnavailable);
}

TEST(WorkerLoop, CancelsAndSaysGoodbyeWhenStopped) {
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

TEST(WorkerLoop, DeliversAFinishedResultBeforeItLeaves) {
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

TEST(WorkerLoop, LetsTheRunningTaskFinishWithinTheGraceWhenStopped) {
  Harness harness;
  harness.options().drain_grace = std::chrono::minutes(10);
  harness.options().drain_ack_wait = std::chrono::seconds(10);
  std::atomic<bool> finish{false};
  harness.StartWorker([&](const v1::TaskSpec& spec, const auto& progress) -> Result<v1::TaskResult> {
    while (!finish && progress(0.5)) std::this_thread::sleep_for(milliseconds(1));
    return ResultOf(spec);
  });
  harness.Welcome();
  harness.Dispatch(kKeyA, 1);
  harness.Await(v1::Envelope::kProgress);
  harness.RequestStop();
  harness.Dispatch(kKeyB, 1);
  const v1::Done refused = harness.AwaitDone();
  EXPECT_ATTEMPT(refused.attempt(), kKeyB, 1);
  EXPECT_EQ(refused.status_code(), static_cast<unsigned>(StatusCode::kCancelled)) << "it takes nothing more";
  harness.Await(v1::Envelope::kProgress);
  finish = true;
  const v1::Done done = harness.AwaitDone();
  EXPECT_ATTEMPT(done.attempt(), kKeyA, 1);
  EXPECT_EQ(done.status_code(), 0u);
  harness.Ack(done.attempt());
  harness.Await(v1::Envelope::kGoodbye);
  EXPECT_TRUE(harness.Join().ok());
}

TEST(WorkerLoop, HandsTheTaskBackWhenTheGraceIsOver) {
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

TEST(WorkerLoop, LeavesByItselfOnceDrained) {
  Harness harness;
  std::atomic<bool> finish{false};
  harness.StartWorker([&](const v1::TaskSpec& spec, const auto& progress) -> Result<v1::TaskResult> {
    while (!finish && progress(0.5)) std::this_thread::sleep_for(milliseconds(1));
    return ResultOf(spec);
  });
  harness.Welcome();
  harness.Dispatch(kKeyA, 1);
  harness.Await(v1::Envelope::kProgress);
  v1::Envelope drain;
  drain.mutable_drain()->set_reason("maintenance");
  harness.Send(drain);
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
