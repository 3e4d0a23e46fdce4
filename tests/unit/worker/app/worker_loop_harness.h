#pragma once

#include <gtest/gtest.h>
#include <stdlib.h>

#include <atomic>
#include <chrono>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <utility>

#include "mosaic/base/check.h"
#include "proto/channel/router_channel.h"
#include "worker/app/worker_loop.h"

namespace trem {

inline const std::string kKeyA(64, 'a');
inline const std::string kKeyB(64, 'b');

inline v1::TaskAttempt Attempt(const std::string& key, std::uint32_t number) {
  v1::TaskAttempt attempt;
  attempt.set_task_key(key);
  attempt.set_attempt(number);
  return attempt;
}

inline v1::TaskResult ResultOf(const v1::TaskSpec& spec) {
  v1::TaskResult result;
  v1::ArtefactRef* output = result.add_outputs();
  output->set_name("out");
  output->set_sha256(spec.key());
  return result;
}

// Works until it is cancelled.
inline Result<v1::TaskResult> UntilCancelled(const v1::TaskSpec&, const std::function<bool(double)>& progress) {
  while (progress(0.5)) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  return Cancelled("stopped as asked");
}

// RunWorkerLoop on a thread of its own, and the coordinator that it talks to, played by the test over ipc.
class Harness {
 public:
  Harness() {
    std::string pattern = (std::filesystem::temp_directory_path() / "trem-loop-XXXXXX").string();
    TREM_CHECK(::mkdtemp(pattern.data()) != nullptr);
    folder_ = pattern;
    endpoint_ = "ipc://" + (folder_ / "socket").string();
    options_.worker_id = "worker-1";
    options_.host = "host";
    options_.hello_interval = std::chrono::milliseconds(100);
    options_.progress_interval = std::chrono::milliseconds(10);
    options_.done_resend = std::chrono::milliseconds(100);
    StartCoordinator();
  }
  ~Harness() {
    if (loop_.joinable()) (void)Stop();
    router_.reset();
    std::filesystem::remove_all(folder_);
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
      auto incoming = router_->Poll(std::chrono::milliseconds(100));
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

  std::filesystem::path folder_;
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

}  // namespace trem
