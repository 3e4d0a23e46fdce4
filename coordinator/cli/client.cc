#include "coordinator/cli/client.h"

#include <algorithm>
#include <optional>
#include <thread>
#include <utility>

#include "coordinator/cli/interrupt.h"

namespace trem {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

constexpr milliseconds kIdleInterval{100};
// An unanswered question is asked again, over a new connection so that a late answer to the first is not taken for one to the next.
constexpr milliseconds kRepeatAfter{3000};

// How long a wait that may take at most kIdleInterval counts as silence of the other side. One that took far longer was none: this process
// did not run (it was stopped, or its machine slept), and an answer may lie there unread.
Clock::duration Waited(Clock::time_point since) { return std::min<Clock::duration>(Clock::now() - since, 2 * kIdleInterval); }

StatusCode CodeFromWire(std::uint32_t code) {
  const bool known = code > static_cast<std::uint32_t>(StatusCode::kOk) && code <= static_cast<std::uint32_t>(StatusCode::kFailed);
  return known ? static_cast<StatusCode>(code) : StatusCode::kFailed;
}

}  // namespace

Client::Client(std::string endpoint, milliseconds patience, Idle idle, KeyPaths keys)
    : endpoint_(std::move(endpoint)), patience_(patience), idle_(std::move(idle)), keys_(std::move(keys)) {}

Client::~Client() = default;

Status Client::Idled() const {
  if (idle_) return idle_();
  return InterruptSignal() == 0 ? Status() : Cancelled("interrupted");
}

Result<v1::Envelope> Client::Ask(const v1::Envelope& question) {
  Clock::duration silence{0};
  while (silence < patience_) {
    TREM_RETURN_IF_ERROR(Idled());
    if (!channel_) {
      TREM_ASSIGN_OR_RETURN(const ChannelOptions options, ChannelOptionsOf(keys_.own, keys_.coordinator));
      TREM_ASSIGN_OR_RETURN(channel_, DealerChannel::Connect(endpoint_, options));
    }
    auto start = Clock::now();
    const Status sent = channel_->Send(question, kIdleInterval);
    if (!sent.ok()) silence += Waited(start);
    if (sent.code() == StatusCode::kUnavailable) continue;
    TREM_RETURN_IF_ERROR(sent);
    const Clock::duration repeat_at = std::min<Clock::duration>(patience_, silence + kRepeatAfter);
    while (silence < repeat_at) {
      start = Clock::now();
      TREM_ASSIGN_OR_RETURN(std::optional<v1::Envelope> answer, channel_->Receive(kIdleInterval));
      if (answer && answer->has_error()) return Status(CodeFromWire(answer->error().status_code()), answer->error().message());
      if (answer && !answer->has_heartbeat()) return *std::move(answer);
      silence += Waited(start);
      TREM_RETURN_IF_ERROR(Idled());
    }
    channel_.reset();
  }
  channel_.reset();
  const std::string hint = keys_.own.empty() ? "" : "; one that does not allow this key, or has another key than the one named, is silent";
  return Unavailable("no coordinator answers at " + endpoint_ + " (waited " + std::to_string(patience_.count() / 1000) + " s)" + hint);
}

Result<v1::JobStatus> Client::AskForJob(const v1::Envelope& question) {
  TREM_ASSIGN_OR_RETURN(const v1::Envelope answer, Ask(question));
  if (!answer.has_job_status()) return Corrupt("the coordinator at " + endpoint_ + " answered with something else than a job's status");
  return answer.job_status();
}

Result<v1::JobStatus> Client::Submit(const std::string& job_id, const v1::Sortie& sortie, int priority) {
  v1::Envelope question;
  question.mutable_submit_job()->set_priority(priority);
  question.mutable_submit_job()->set_job_id(job_id);
  *question.mutable_submit_job()->mutable_sortie() = sortie;
  return AskForJob(question);
}

Result<v1::JobStatus> Client::GetJob(const std::string& job_id) {
  v1::Envelope question;
  question.mutable_get_job()->set_job_id(job_id);
  return AskForJob(question);
}

void Client::SendShutdown() {
  v1::Envelope question;
  question.mutable_shutdown();
  // Lost or not: SIGTERM follows.
  if (channel_) (void)channel_->Send(question, kIdleInterval).ok();
}

Status Client::Pause(milliseconds duration) {
  const auto deadline = Clock::now() + duration;
  for (;;) {
    TREM_RETURN_IF_ERROR(Idled());
    const auto now = Clock::now();
    if (now >= deadline) return {};
    std::this_thread::sleep_for(std::min<Clock::duration>(kIdleInterval, deadline - now));
  }
}

}  // namespace trem
