#pragma once

#include <cstdint>
#include <string>
#include <unordered_map>

#include "coordinator/scheduling/events.h"
#include "mosaic/base/status.h"
#include "proto/channel/router_channel.h"

namespace trem {

struct GateOptions {
  // Messages a second that one client key, or one connection of a worker, may send for long; four times as many at once.
  double client_messages_per_s_max = 200.0;
  double worker_messages_per_s_max = 20'000.0;
  // A submitted spec. The largest sensible one has a few kilobytes.
  std::size_t job_bytes_max = std::size_t{1} << 20;
};

// Messages that were not let through, since the start.
struct GateCounters {
  std::uint64_t wrong_role = 0;
  std::uint64_t too_many = 0;
  std::uint64_t too_large = 0;
  std::uint64_t malformed = 0;
};

// Stands between the socket and the shell: who may say what, how often, and how much. Not thread-safe.
class Gate {
 public:
  explicit Gate(const GateOptions& options = {}) : options_(options) {}

  // Ok: hand it to the shell. Otherwise why not: kInvalidInput for a role that may not say this, kExhausted for too often or too large, or
  // the error with which the message came.
  Status Admit(TimeMs now_ms, const RouterChannel::Incoming& incoming);
  // Whether a refusal is to be logged and answered: at most once a second to one peer and 20 times a second in all, so that whoever floods
  // gets neither the log nor the line.
  bool MayAnswer(TimeMs now_ms, const std::string& peer);
  const GateCounters& counters() const { return counters_; }

 private:
  // A token bucket.
  struct Budget {
    double tokens = 0.0;
    TimeMs filled_at_ms = 0;
  };
  bool TakeToken(TimeMs now_ms, const RouterChannel::Incoming& incoming);
  void ForgetIdle(TimeMs now_ms);

  GateOptions options_;
  GateCounters counters_;
  std::unordered_map<std::string, Budget> budgets_;      // By key (clients) or connection.
  std::unordered_map<std::string, TimeMs> answered_at_;  // By connection.
  TimeMs answers_counted_from_ms_ = 0;
  int answers_counted_ = 0;
  TimeMs next_forget_ms_ = 0;
};

// Whether a peer of this role may send this kind of message; an unspecified role (no keys in use) may send everything.
bool MaySend(v1::Role role, v1::Envelope::BodyCase body);

}  // namespace trem
