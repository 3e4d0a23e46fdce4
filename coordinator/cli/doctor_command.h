#pragma once

#include "coordinator/cli/client_commands.h"

namespace trem {

// `trem doctor`: versions of the programs, processor, memory, disk, limits, keys and, where one is named, the coordinator. Exit code 0 when nothing
// that it looked at is wrong.
int RunDoctorCommand(const RemoteOptions& remote);

}  // namespace trem
