#pragma once

#include <spdlog/spdlog.h>

#include <string>

namespace trem {

// Sends spdlog's default logger to stderr as "time level [program] message". `level` is one of trace, debug, info, warn, error, off;
// anything else means info. Programs call it once at start; libraries only use spdlog::info and its siblings.
void ConfigureLog(const std::string& program, const std::string& level);

}  // namespace trem
