#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "worker/telemetry/predicted_motion.h"
#include "worker/telemetry/telemetry_track.h"

namespace trem {

// How the image moved into a frame: where the middle of the frame at `time_s` was in the frame before, at `previous_time_s`, less that
// middle, sensor pixels.
struct MeasuredMotion {
  double previous_time_s = 0.0;
  double time_s = 0.0;
  Eigen::Vector2d shift_px = Eigen::Vector2d::Zero();
};

struct TimeOffsetOptions {
  MotionGeometry geometry;
  double range_s = 2.0;  // Offsets of up to this much are tried.
  double step_s = 0.02;
};

struct TimeOffset {
  double offset_s = 0.0;  // A frame at t shows what the telemetry says for t + offset_s.
  double sigma_s = 0.0;
  double rms_px = 0.0;          // Robust rms of measured minus predicted motion at the offset...
  double rms_at_zero_px = 0.0;  // ... and without one.
  int pairs = 0;
  bool determined = false;
  std::string reason;  // Why not.
};

// The offset at which the motion that poses predict fits the measured one best, by the sum of Huber losses over the pairs (scale: the
// robust spread at the best offset), refined by a parabola through the best and its neighbours; sigma from the parabola's bend, with pairs
// four apart counted as independent. It is determined when at least 20 pairs take part, the minimum lies inside the range, sigma is below a
// tenth of a second, and the fit is better than without an offset by more than 10 % in rms. A path at constant speed and attitude
// determines none.
TimeOffset EstimateTimeOffset(const TelemetryTrack& track, const std::vector<MeasuredMotion>& motions, const TimeOffsetOptions& options);

}  // namespace trem
