#pragma once

#include <string>

#include "mosaic/base/status.h"

namespace trem {

// The documented exit codes of `trem`.
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

// Whether messages on stderr may be coloured: a terminal, NO_COLOR unset or empty, TERM not "dumb".
bool ColourOnStderr();
bool StderrIsTerminal();
// Columns of the terminal on stderr; 80 when unknown.
int StderrColumns();

// Prints "trem: error: <message>" or "trem: warning: <message>" to stderr.
void PrintError(const std::string& message);
void PrintWarning(const std::string& message);

// "12.3 MB", decimal units.
std::string FormatBytes(double bytes);
// "0:07", "12:34", "1:02:03".
std::string FormatDuration(double seconds);

}  // namespace trem
