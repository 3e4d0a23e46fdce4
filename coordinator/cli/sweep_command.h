#pragma once

#include <cstdint>

#include "coordinator/cli/client_commands.h"

namespace trem {

// `trem sweep`: removes from a coordinator's object store what no job has and what is older than `older_than_s`. Runs where the store's
// credentials are: the coordinator says what is in use, the trem-worker beside this program lists and removes. Returns the exit code.
int RunSweepCommand(const RemoteOptions& remote, std::int64_t older_than_s);

}  // namespace trem
