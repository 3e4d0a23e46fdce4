#pragma once

#include <string>

namespace trem {

// Prints "file:line: check failed: <condition> <message>" to stderr and aborts.
[[noreturn]] void CheckFailed(const char* file, int line, const char* condition, const std::string& message);

}  // namespace trem

// A broken check is a bug in this program, never bad input. On in release builds too.
#define TREM_CHECK(condition) TREM_CHECK_MSG(condition, "")
#define TREM_CHECK_MSG(condition, message)                                                   \
  do {                                                                                       \
    if (!(condition)) [[unlikely]] ::trem::CheckFailed(__FILE__, __LINE__, #condition, message); \
  } while (false)
