#pragma once

#include "proto/trem/v1/task.pb.h"

namespace trem {

// How a frame's fate in a window is called in the chain files.
inline const char* OutcomeName(v1::OutcomeCode outcome) {
  switch (outcome) {
    case v1::REGISTERED:
      return "registered";
    case v1::STARTED_SCENE:
      return "started_scene";
    case v1::SKIPPED:
      return "skipped";
    default:
      return "lost";
  }
}

}  // namespace trem
