#include "coordinator/cli/remote.h"

#include "coordinator/cli/interrupt.h"
#include "coordinator/cli/terminal.h"
#include "proto/codec/envelope.h"

namespace trem {
namespace {

constexpr std::chrono::seconds kPatience{5};
// Some cluster managers take minutes to start a coordinator again.
constexpr std::chrono::minutes kAbsenceMax{10};
constexpr std::chrono::milliseconds kAskAgain{500};

}  // namespace

int ReportFailure(const Status& status) {
  if (InterruptSignal() != 0) return kExitSignalBase + InterruptSignal();
  if (status.code() == StatusCode::kUnavailable) {
    PrintError(status.message() + "; is trem-coordinator running there? --coordinator or TREM_COORDINATOR name its endpoint");
  } else {
    PrintError(status.message());
  }
  return ExitCodeOf(status.code());
}

Client MakeClient(const RemoteOptions& remote) {
  CountInterrupts();
  return Client(remote.coordinator, kPatience, {}, {remote.key, remote.coordinator_key});
}

bool Absence::Outlasts(const Status& status, Client* client) {
  const bool is_away = status.code() == StatusCode::kUnavailable || status.code() == StatusCode::kExhausted;
  if (!is_away) {
    has_answered_ |= status.ok();
    since_.reset();
    return false;
  }
  if (!has_answered_) return false;
  const auto now = std::chrono::steady_clock::now();
  if (!since_) {
    since_ = now;
    PrintWarning(status.message() + "; waiting for it for up to " + std::to_string(kAbsenceMax.count()) + " minutes");
  }
  return now - *since_ < kAbsenceMax && client->Pause(kAskAgain).ok();
}

Status CheckJobId(const std::string& job_id) {
  if (IsJobId(job_id)) return {};
  return InvalidInput("'" + job_id + "' is not a job id; expected 1 to 64 of a-z, 0-9 and '-'; 'trem list' shows the jobs");
}

std::string ForTerminal(std::string text) {
  for (char& c : text) {
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) c = '?';
  }
  return text;
}

}  // namespace trem
