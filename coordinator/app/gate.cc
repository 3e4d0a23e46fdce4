#include "coordinator/app/gate.h"

#include <algorithm>

namespace trem {
namespace {

constexpr double kBurstSeconds = 4.0;
constexpr TimeMs kAnswerIntervalMs = 1'000;
constexpr int kAnswersPerSecondMax = 20;
constexpr TimeMs kForgetIntervalMs = 10'000;

std::string KindOf(v1::Envelope::BodyCase body) {
  const auto* field = v1::Envelope::descriptor()->FindFieldByNumber(static_cast<int>(body));
  return field == nullptr ? "unknown" : field->name();
}

// Whether a new connection costs a client nothing: then the budget belongs to the key.
bool IsSharedByKey(const RouterChannel::Incoming& incoming) { return !incoming.user.empty() && incoming.role != v1::WORKER; }

}  // namespace

bool MaySend(v1::Role role, v1::Envelope::BodyCase body) {
  if (role == v1::ROLE_UNSPECIFIED) return true;
  const bool asks = role == v1::CLIENT || role == v1::ADMIN;
  switch (body) {
    case v1::Envelope::kHello:
    case v1::Envelope::kProgress:
    case v1::Envelope::kDone:
    case v1::Envelope::kGoodbye:
    case v1::Envelope::kTaskLog:
      return role == v1::WORKER;
    case v1::Envelope::kSubmitJob:
    case v1::Envelope::kGetJob:
    case v1::Envelope::kListJobs:
    case v1::Envelope::kCancelJob:
    case v1::Envelope::kRetryJob:
    case v1::Envelope::kRemoveJob:
    case v1::Envelope::kListWorkers:
    case v1::Envelope::kGetLog:
    case v1::Envelope::kGetServiceReport:
      return asks;
    case v1::Envelope::kBackup:
    case v1::Envelope::kListArtefacts:
    case v1::Envelope::kDrainWorker:
    case v1::Envelope::kShutdown:
      return role == v1::ADMIN;
    case v1::Envelope::kGetDataLane:
    case v1::Envelope::kGetChunk:
    case v1::Envelope::kPutChunk:
    case v1::Envelope::kHeartbeat:
      return asks || role == v1::WORKER;
    default:
      return false;
  }
}

Status Gate::Admit(TimeMs now_ms, const RouterChannel::Incoming& incoming) {
  ForgetIdle(now_ms);
  if (!TakeToken(now_ms, incoming)) {
    ++counters_.too_many;
    return Exhausted("too many messages; this one was dropped: send fewer than a few hundred a second");
  }
  if (!incoming.envelope.ok()) {
    ++counters_.malformed;
    return incoming.envelope.status();
  }
  const v1::Envelope& envelope = *incoming.envelope;
  if (!MaySend(incoming.role, envelope.body_case())) {
    ++counters_.wrong_role;
    return InvalidInput("key '" + incoming.user + "' has the role " + RoleName(incoming.role) + " and may not send " +
                        KindOf(envelope.body_case()) + "; use a key of another role (`trem keys`)");
  }
  if (envelope.has_submit_job() && incoming.bytes > options_.job_bytes_max) {
    ++counters_.too_large;
    return Exhausted("the job's spec has " + std::to_string(incoming.bytes) + " bytes; at most " + std::to_string(options_.job_bytes_max) +
                     " are accepted");
  }
  return {};
}

bool Gate::MayAnswer(TimeMs now_ms, const std::string& peer) {
  if (now_ms - answers_counted_from_ms_ >= kAnswerIntervalMs) {
    answers_counted_from_ms_ = now_ms;
    answers_counted_ = 0;
  }
  if (answers_counted_ >= kAnswersPerSecondMax) return false;
  const auto [found, is_first] = answered_at_.try_emplace(peer, now_ms);
  if (!is_first && now_ms - found->second < kAnswerIntervalMs) return false;
  found->second = now_ms;
  ++answers_counted_;
  return true;
}

bool Gate::TakeToken(TimeMs now_ms, const RouterChannel::Incoming& incoming) {
  const bool by_key = IsSharedByKey(incoming);
  const double rate = by_key ? options_.client_messages_per_s_max : options_.worker_messages_per_s_max;
  const double burst = rate * kBurstSeconds;
  const auto [found, is_new] = budgets_.try_emplace(by_key ? "key " + incoming.user : "peer " + incoming.peer, Budget{burst, now_ms});
  Budget& budget = found->second;
  budget.tokens = std::min(burst, budget.tokens + rate * static_cast<double>(now_ms - budget.filled_at_ms) / 1000.0);
  budget.filled_at_ms = now_ms;
  if (budget.tokens < 1.0) return false;
  budget.tokens -= 1.0;
  return true;
}

void Gate::ForgetIdle(TimeMs now_ms) {
  if (now_ms < next_forget_ms_) return;
  next_forget_ms_ = now_ms + kForgetIntervalMs;
  // After the time of a burst a budget is full again: as good as none.
  const auto burst_ms = static_cast<TimeMs>(kBurstSeconds * 1000.0);
  std::erase_if(budgets_, [&](const auto& entry) { return now_ms - entry.second.filled_at_ms > burst_ms; });
  std::erase_if(answered_at_, [&](const auto& entry) { return now_ms - entry.second > kAnswerIntervalMs; });
}

}  // namespace trem
