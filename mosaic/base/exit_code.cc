#include "mosaic/base/exit_code.h"

namespace trem {

ExitCode ExitCodeOf(StatusCode code) {
  switch (code) {
    case StatusCode::kOk:
      return kExitDone;
    case StatusCode::kInvalidInput:
    case StatusCode::kNotFound:
      return kExitInvalidInput;
    case StatusCode::kUnavailable:
      return kExitNoCoordinator;
    case StatusCode::kExhausted:
    case StatusCode::kCancelled:
    case StatusCode::kCorrupt:
    case StatusCode::kFailed:
      break;
  }
  return kExitFailed;
}

}  // namespace trem
