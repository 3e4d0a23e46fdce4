#pragma once

#include <spdlog/spdlog.h>

#include <initializer_list>
#include <string>
#include <string_view>

#include "mosaic/base/status.h"

namespace trem {

// Sends spdlog's default logger to stderr. `level` is one of trace, debug, info, warn, error, off; anything else means info. `format`:
//   text  "time level [program] message key=value ..."
//   json  one object a line: {"time": ..., "level": ..., "program": ..., "message": ..., "key": "value", ...}
// Programs call it once at start; libraries only use LogWith, spdlog::info and its siblings. kInvalidInput for another format.
Status ConfigureLog(const std::string& program, const std::string& level, const std::string& format = "text");

// What a line is about, for those who search for it: job, task, attempt, worker.
struct LogField {
  const char* key;
  std::string value;
};
void LogWith(spdlog::level::level_enum level, std::string_view message, std::initializer_list<LogField> fields);

}  // namespace trem
