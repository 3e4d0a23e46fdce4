#include "worker/app/worker_loop.h"

#include <unistd.h>

#include <algorithm>
#include <deque>
#include <optional>
#include <thread>
#include <utility>
#include <vector>

#include "mosaic/base/log.h"
#include "mosaic/base/wall_clock.h"
#include "proto/codec/envelope.h"
#include "worker/app/done_message.h"

namespace trem {
namespace {

using std::chrono::milliseconds;
using Clock = std::chrono::steady_clock;
using TimePoint = Clock::time_point;

constexpr int kExitStuck = 9;
constexpr std::size_t kQueueMax = 4;  // The coordinator knows that there is one slot; more than one here is a race, more than this a bug.
constexpr milliseconds kUnsentRetry{100};
constexpr milliseconds kWaitMax{200};
constexpr milliseconds kProgressPoll{50};  // The compute thread does not wake this one for every step.

bool Same(const v1::TaskAttempt& a, const v1::TaskAttempt& b) { return a.task_key() == b.task_key() && a.attempt() == b.attempt(); }

v1::TaskAttempt AttemptOf(const v1::Dispatch& dispatch) {
  v1::TaskAttempt attempt;
  attempt.set_task_key(dispatch.task().key());
  attempt.set_attempt(dispatch.attempt());
  return attempt;
}

class WorkerLoop {
 public:
  WorkerLoop(const WorkerOptions& options, DealerChannel* channel, ComputeThread::Task task, const std::atomic<bool>& stop)
      : options_(options), channel_(*channel), stop_(stop), compute_(std::move(task), [channel] { channel->Wake(); }) {}

  Status Run() {
    last_heard_ = Clock::now();
    for (;;) {
      const TimePoint now = Clock::now();
      if (stop_ && !is_stopping_) BeginStop(now);
      if (cancel_at_ && now >= *cancel_at_ && running_) CancelRunning("this worker stops", now);
      CollectFinished(now);
      StartNext();
      SendDue(now);
      ExitWhenStuck(now);
      if (drain_deadline_ && !running_ && (unacknowledged_.empty() || now >= *drain_deadline_)) return Leave();
      if (options_.give_up.count() > 0 && now - last_heard_ > options_.give_up) {
        return Abandon(Unavailable("the coordinator has not been heard of for " + std::to_string(options_.give_up.count() / 1000) + " s"));
      }
      auto received = channel_.Receive(WaitTime(now));
      if (!received.ok()) {
        if (received.status().code() == StatusCode::kInvalidInput) return Abandon(received.status());
        spdlog::warn("ignored {}", received.status().message());
      } else if (received->has_value()) {
        if (Status refused = On(**received, Clock::now()); !refused.ok()) return Abandon(std::move(refused));
      }
    }
  }

 private:
  struct PendingDone {
    v1::Envelope envelope;
    TimePoint due{};  // When to send it (again).
    const v1::TaskAttempt& attempt() const { return envelope.done().attempt(); }
  };

  // ---- Messages from the coordinator. An error ends the loop. -------------------------------------------------------------------------

  Status On(const v1::Envelope& envelope, TimePoint now) {
    last_heard_ = now;
    switch (envelope.body_case()) {
      case v1::Envelope::kWelcome:
        OnWelcome(envelope.welcome());
        break;
      case v1::Envelope::kDispatch:
        OnDispatch(envelope.dispatch(), now);
        break;
      case v1::Envelope::kAck:
        std::erase_if(unacknowledged_, [&](const PendingDone& done) { return Same(done.attempt(), envelope.ack().attempt()); });
        break;
      case v1::Envelope::kCancelTask:
        OnCancel(envelope.cancel_task(), now);
        break;
      case v1::Envelope::kShare:
        OnShare(envelope.share());
        break;
      case v1::Envelope::kDrain:
        spdlog::info("asked to leave when the running task is done: {}", envelope.drain().reason());
        BeginDrain(now);
        break;
      case v1::Envelope::kError:
        return OnError(envelope.error());
      case v1::Envelope::kBye:
        spdlog::info("the coordinator leaves");
        is_welcome_ = false;
        break;
      case v1::Envelope::kHeartbeat:
        break;
      default:
        spdlog::warn("ignored a message that is not for workers (field {} of Envelope)", static_cast<int>(envelope.body_case()));
    }
    return {};
  }

  void OnWelcome(const v1::Welcome& welcome) {
    if (!is_welcome_) spdlog::info("welcomed by the coordinator as {}", options_.worker_id);
    is_welcome_ = true;
    heartbeat_interval_ = milliseconds(welcome.heartbeat_interval_ms());
    for (PendingDone& done : unacknowledged_) done.due = {};  // The coordinator may have restarted without having read them.
  }

  Status OnError(const v1::ErrorReply& error) {
    const auto code = static_cast<StatusCode>(error.status_code());
    if (code == StatusCode::kUnavailable) {  // It restarted, or took this worker for lost.
      spdlog::info("the coordinator does not know this worker: {}", error.message());
      is_welcome_ = false;
      next_hello_ = {};
      return {};
    }
    if (is_welcome_ || code == StatusCode::kOk) {
      spdlog::warn("the coordinator reports: {}", error.message());
      return {};
    }
    return Status(code, "the coordinator refused this worker: " + error.message());
  }

  void OnDispatch(const v1::Dispatch& dispatch, TimePoint now) {
    const v1::TaskAttempt attempt = AttemptOf(dispatch);
    if (drain_deadline_) return HandBack(attempt, now);
    for (PendingDone& done : unacknowledged_) {
      if (done.attempt().task_key() != attempt.task_key()) continue;
      if (done.attempt().attempt() > attempt.attempt()) return;
      if (done.envelope.done().status_code() != 0 && !Same(done.attempt(), attempt)) continue;
      *done.envelope.mutable_done()->mutable_attempt() = attempt;
      done.due = {};
      return;
    }
    std::erase_if(unacknowledged_, [&](const PendingDone& done) { return done.attempt().task_key() == attempt.task_key(); });
    if (running_ && running_->task_key() == attempt.task_key()) {
      if (running_->attempt() >= attempt.attempt()) return;
      CancelRunning("a newer attempt was dispatched", now);
    }
    std::erase_if(queued_, [&](const v1::Dispatch& other) { return other.task().key() == attempt.task_key(); });
    if (queued_.size() >= kQueueMax) {
      spdlog::warn("ignored the dispatch of task {}: {} others wait for the one compute slot", attempt.task_key(), queued_.size());
      return;
    }
    queued_.push_back(dispatch);
  }

  void OnCancel(const v1::CancelTask& cancel, TimePoint now) {
    if (running_ && Same(*running_, cancel.attempt())) return CancelRunning(cancel.reason(), now);
    // Whatever else is known of it is not wanted any more; the answer says that nothing of it is left here.
    std::erase_if(queued_, [&](const v1::Dispatch& dispatch) { return Same(AttemptOf(dispatch), cancel.attempt()); });
    std::erase_if(unacknowledged_, [&](const PendingDone& done) { return Same(done.attempt(), cancel.attempt()); });
    Send(MakeDone(cancel.attempt(), {Cancelled("cancelled before it started or after it was done"), milliseconds(0)}), now);
  }

  void OnShare(const v1::Share& share) {
    share_ = share;  // Its task may still wait for the slot.
    if (running_ && Same(*running_, share.attempt())) ApplyShare();
  }

  void ApplyShare() {
    const bool is_told = share_ && Same(*running_, share_->attempt());
    if (options_.on_share) options_.on_share(is_told ? static_cast<int>(share_->processors()) : 1);
  }

  // ---- The compute slot ---------------------------------------------------------------------------------------------------------------

  void CancelRunning(const std::string& reason, TimePoint now) {
    compute_.Cancel();
    if (stuck_deadline_) return;
    spdlog::info("cancelling task {} attempt {}: {}", running_->task_key(), running_->attempt(), reason);
    stuck_deadline_ = now + options_.cancel_grace;
  }

  void StartNext() {
    if (running_ || queued_.empty() || !unacknowledged_.empty() || drain_deadline_) return;
    v1::Dispatch dispatch = std::move(queued_.front());
    queued_.pop_front();
    running_ = AttemptOf(dispatch);
    next_progress_ = {};
    next_log_ = Clock::now() + options_.log_interval;
    if (options_.log != nullptr) options_.log->Begin();
    LogWith(spdlog::level::info, v1::TaskKind_Name(dispatch.task().kind()) + " begins",
            {{"task", running_->task_key()}, {"attempt", std::to_string(running_->attempt())}, {"worker", options_.worker_id}});
    ApplyShare();
    compute_.Start(std::move(*dispatch.mutable_task()));
  }

  void CollectFinished(TimePoint now) {
    auto finished = compute_.TakeFinished();
    if (!finished) return;
    v1::TaskAttempt attempt = *std::exchange(running_, std::nullopt);
    stuck_deadline_.reset();
    SendLog(attempt, true, now);
    LogWith(spdlog::level::info,
            "ended after " + std::to_string(finished->elapsed.count()) + " ms: " + finished->outcome.result.status().ToString(),
            {{"task", attempt.task_key()}, {"attempt", std::to_string(attempt.attempt())}, {"worker", options_.worker_id}});
    const Result<v1::TaskResult>& result = finished->outcome.result;
    if (drain_deadline_) drain_deadline_ = now + options_.drain_ack_wait;
    const bool is_cancelled = !result.ok() && result.status().code() == StatusCode::kCancelled;
    if (drain_deadline_ && is_cancelled) return;  // Goodbye hands it back.
    const auto newer =
        std::find_if(queued_.begin(), queued_.end(), [&](const v1::Dispatch& other) { return other.task().key() == attempt.task_key(); });
    if (newer != queued_.end()) {
      if (!result.ok()) return;  // The newer attempt computes it again.
      attempt.set_attempt(newer->attempt());
      queued_.erase(newer);
    }
    unacknowledged_.push_back({MakeDone(attempt, *finished), now});
  }

  void ExitWhenStuck(TimePoint now) const {
    if (!stuck_deadline_ || now < *stuck_deadline_) return;
    spdlog::critical("task {} did not stop within {} ms of being cancelled; this process exits", running_->task_key(),
                     options_.cancel_grace.count());
    spdlog::default_logger()->flush();
    ::_exit(kExitStuck);
  }

  // ---- Messages to the coordinator ----------------------------------------------------------------------------------------------------

  bool Send(const v1::Envelope& envelope, TimePoint now) {
    if (!channel_.Send(envelope).ok()) return false;
    last_sent_ = now;
    return true;
  }

  void SendDue(TimePoint now) {
    if (is_welcome_ && now - last_heard_ > 3 * heartbeat_interval_) {
      spdlog::debug("the coordinator is silent; introducing this worker again");
      is_welcome_ = false;
    }
    if (!is_welcome_ && now >= next_hello_) {
      next_hello_ = now + (Send(MakeHello(), now) ? options_.hello_interval : kUnsentRetry);
      share_.reset();  // As the coordinator does at a Hello.
      if (running_) ApplyShare();
    }
    if (!is_welcome_) return;  // What a coordinator that does not know this worker reads now, it could not place.
    for (PendingDone& done : unacknowledged_) {
      if (now >= done.due) done.due = now + (Send(done.envelope, now) ? options_.done_resend : kUnsentRetry);
    }
    if (running_ && now >= next_progress_) {
      if (const auto fraction = compute_.TakeProgress()) {
        v1::Envelope envelope;
        *envelope.mutable_progress()->mutable_attempt() = *running_;
        envelope.mutable_progress()->set_fraction(*fraction);
        Send(envelope, now);
        next_progress_ = now + options_.progress_interval;
      }
    }
    if (running_ && options_.log != nullptr && now >= next_log_) {
      next_log_ = now + options_.log_interval;
      SendLog(*running_, false, now);
    }
    if (now - last_sent_ >= heartbeat_interval_) {
      v1::Envelope envelope;
      envelope.mutable_heartbeat();
      if (!Send(envelope, now)) is_welcome_ = false;  // The connection broke: a new one begins with Hello.
    }
  }

  // Lost or not: nothing depends on it.
  void SendLog(const v1::TaskAttempt& attempt, bool is_end, TimePoint now) {
    if (options_.log == nullptr) return;
    std::vector<std::string> lines = options_.log->Take(is_end);
    if (lines.empty() || !is_welcome_) return;
    v1::Envelope envelope;
    *envelope.mutable_task_log()->mutable_attempt() = attempt;
    for (std::string& line : lines) envelope.mutable_task_log()->add_lines(std::move(line));
    Send(envelope, now);
  }

  v1::Envelope MakeHello() const {
    v1::Envelope envelope;
    v1::Hello* hello = envelope.mutable_hello();
    hello->set_protocol_version(kProtocolVersion);
    hello->set_worker_id(options_.worker_id);
    hello->set_host(options_.host);
    hello->set_pid(options_.pid);
    hello->set_engine_revision(options_.engine_revision);
    hello->set_credit(drain_deadline_ ? 0 : 1);
    hello->set_memory_bytes_max(options_.memory_bytes_max);
    hello->set_clock_ms(WallClockMs());
    if (running_) *hello->add_running() = *running_;
    for (const v1::Dispatch& dispatch : queued_) *hello->add_running() = AttemptOf(dispatch);
    for (const PendingDone& done : unacknowledged_) *hello->add_running() = done.attempt();
    return envelope;
  }

  // How long nothing has to be done unless a message, a finished task or a signal comes.
  milliseconds WaitTime(TimePoint now) const {
    TimePoint next = now + kWaitMax;
    if (!is_welcome_) next = std::min(next, next_hello_);
    if (is_welcome_) {
      next = std::min(next, last_sent_ + heartbeat_interval_);
      if (running_) next = std::min(next, std::max(next_progress_, now + kProgressPoll));
      for (const PendingDone& done : unacknowledged_) next = std::min(next, done.due);
    }
    if (stuck_deadline_) next = std::min(next, *stuck_deadline_);
    if (drain_deadline_ && !running_) next = std::min(next, std::max(now + milliseconds(10), *drain_deadline_));
    if (cancel_at_ && !stuck_deadline_) next = std::min(next, std::max(now + milliseconds(10), *cancel_at_));
    return std::max(milliseconds(0), std::chrono::ceil<milliseconds>(next - now));
  }

  // ---- Leaving ------------------------------------------------------------------------------------------------------------------------

  // Takes nothing more, and leaves when what runs is done.
  void BeginDrain(TimePoint now) {
    if (!drain_deadline_) drain_deadline_ = now + options_.drain_ack_wait;
    // Goodbye would hand them back too, but only when the running task is done.
    for (const v1::Dispatch& dispatch : std::exchange(queued_, {})) HandBack(AttemptOf(dispatch), now);
  }

  // The same, and what runs is handed back when it is not done in time.
  void BeginStop(TimePoint now) {
    is_stopping_ = true;
    spdlog::info("asked to stop");
    BeginDrain(now);
    cancel_at_ = now + options_.drain_grace;
  }

  void HandBack(const v1::TaskAttempt& attempt, TimePoint now) {
    Send(MakeDone(attempt, {Cancelled("this worker leaves"), milliseconds(0)}), now);
  }

  Status Leave() {
    v1::Envelope envelope;
    envelope.mutable_goodbye()->set_reason("stopped by a signal");
    if (channel_.Send(envelope).ok()) spdlog::info("left the coordinator");
    return {};
  }

  // Ends the computation, then the loop.
  Status Abandon(Status status) {
    if (!running_) return status;
    CancelRunning(status.message(), Clock::now());
    while (!compute_.TakeFinished()) {
      ExitWhenStuck(Clock::now());
      std::this_thread::sleep_for(milliseconds(10));
    }
    return status;
  }

  const WorkerOptions& options_;
  DealerChannel& channel_;
  const std::atomic<bool>& stop_;

  bool is_welcome_ = false;
  milliseconds heartbeat_interval_{1000};
  TimePoint last_heard_{};
  TimePoint last_sent_{};
  TimePoint next_hello_{};
  TimePoint next_progress_{};
  TimePoint next_log_{};
  std::optional<TimePoint> stuck_deadline_;  // Set while the running task is cancelled.
  std::optional<TimePoint> drain_deadline_;  // Set once this worker leaves: how long it waits for Acks when nothing runs.
  std::optional<TimePoint> cancel_at_;       // Set once it was told to stop: what runs then is handed back.
  bool is_stopping_ = false;

  std::optional<v1::TaskAttempt> running_;
  std::deque<v1::Dispatch> queued_;
  std::optional<v1::Share> share_;  // What was said last.
  std::vector<PendingDone> unacknowledged_;
  ComputeThread compute_;
};

}  // namespace

Status RunWorkerLoop(const WorkerOptions& options, DealerChannel* channel, ComputeThread::Task task, const std::atomic<bool>& stop) {
  return WorkerLoop(options, channel, std::move(task), stop).Run();
}

}  // namespace trem
