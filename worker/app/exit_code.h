#pragma once

#include "mosaic/base/status.h"

namespace trem {

// The exit code of a command that ends with `status`: 0 done, 3 invalid input, 4 coordinator not reachable, 1 others.
inline int ExitCodeOf(const Status& status) {
  switch (status.code()) {
    case StatusCode::kOk:
      return 0;
    case StatusCode::kInvalidInput:
    case StatusCode::kNotFound:
      return 3;
    case StatusCode::kUnavailable:
      return 4;
    default:
      return 1;
  }
}

// Of a command line that was not understood.
inline constexpr int kExitUsage = 2;

}  // namespace trem
