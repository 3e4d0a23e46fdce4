#pragma once

#include "mosaic/base/status.h"

namespace trem {

// The documented exit codes of every program of this project.
enum ExitCode : int {
  kExitDone = 0,
  kExitFailed = 1,
  kExitUsage = 2,
  kExitInvalidInput = 3,
  kExitNoCoordinator = 4,
  kExitDoneInPart = 5,
  kExitSignalBase = 128,  // Interrupted: this plus the signal's number.
};

ExitCode ExitCodeOf(StatusCode code);
inline ExitCode ExitCodeOf(const Status& status) { return ExitCodeOf(status.code()); }

}  // namespace trem
