#pragma once

#include <string>

#include "mosaic/base/exit_code.h"

namespace trem {

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
