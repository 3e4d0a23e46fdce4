#pragma once

#include <optional>

#include "worker/registration/target.h"
#include "worker/registration/view.h"

namespace trem {

struct Brightness {
  double gain = 1.0;
  double offset = 0.0;
};

// Gain and offset of a frame against the prediction when they have jumped (automatic gain control, a flat-field event) further than a
// registration that starts from `expected`'s would follow; nothing when they have not. From the 10th, 50th and 90th percentile of both
// where the frame meets seen scene at `expected`, so it holds whatever lies between: no pixel has to be registered. A frame without
// texture yields an offset only.
std::optional<Brightness> BrightnessJump(const Observation& observation, const Reference& reference, const View& expected);

}  // namespace trem
