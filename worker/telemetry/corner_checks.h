#pragma once

#include <string>
#include <vector>

#include "worker/telemetry/telemetry_audit.h"

namespace trem {

struct CornerCheck {
  std::vector<CornerSample> plausible;
  std::vector<std::string> doubts;
};

// Which of the stated image corners can be an image's: no corner without a place (0, 0), a convex quadrilateral that runs clockwise seen
// from above (so that the image is not mirrored), no side beyond 100 km, and around the frame centre where that is stated.
CornerCheck CheckCorners(const std::vector<TelemetryRecord>& records);

}  // namespace trem
