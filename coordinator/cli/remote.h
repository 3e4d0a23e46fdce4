#pragma once

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
Status CheckJobId(const std::string& job_id);
// Texts that came from elsewhere, for a terminal: control characters become '?'.
std::string ForTerminal(std::string text);

}  // namespace trem
