#pragma once

#include <chrono>
#include <optional>
#include <string>

#include "coordinator/cli/client.h"
#include "coordinator/cli/client_commands.h"
#include "mosaic/base/status.h"

namespace trem {

// What commands for a running coordinator have in common.

// Prints what went wrong and returns its exit code.
int ReportFailure(const Status& status);
// A client for the coordinator that `remote` names; an interrupt ends what it waits for.
Client MakeClient(const RemoteOptions& remote);
// For commands that go on for as long as a job does: what they do when a coordinator that has answered is away for a while, because it
// restarts, was moved, or waits for room on its disk.
class Absence {
 public:
  // Whether to ask again what was just answered with `status`: it says that the coordinator is away, which has answered before, less than
  // ten minutes ago. Warns on stderr when it begins to be, and waits a moment by `client`.
  bool Outlasts(const Status& status, Client* client);

 private:
  bool has_answered_ = false;
  std::optional<std::chrono::steady_clock::time_point> since_;
};

Status CheckJobId(const std::string& job_id);
// Texts that came from elsewhere, for a terminal: control characters become '?'.
std::string ForTerminal(std::string text);

}  // namespace trem
