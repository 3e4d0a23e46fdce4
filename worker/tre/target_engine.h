#pragma once

#include <functional>
#include <optional>
#include <string>

#include "worker/tre/mapping_engine.h"

namespace trem {

// One whole frame.
struct TargetFrame {
  std::string skip_reason;  // Not empty: the frame cannot be used, and why.
  Image<float> pixels;      // The whole sensor, internal grey levels; NaN: no measurement.
  Image<float> weights;     // See Observation::weights; empty: all 1.
  // Sensor pixels of this frame to those of the previous usable one, of the ground; nothing when that is not known.
  std::optional<Affine> previous_from_current;
};

struct TargetRequest {
  Roi roi_in_sensor;    // Around the target, in the reference frame.
  int reference = 0;    // The frame it was picked in.
  int frame_begin = 0;  // Frames to use: [frame_begin, frame_end).
  int frame_end = 0;
  Roi sensor;           // All pixels of a frame.
};

// Gives frame `index`. Called with the reference frame and those after it in order, then with those before it in descending order.
using TargetFrames = std::function<Result<TargetFrame>(int index)>;

// Target mode: the ROI that was picked in one frame is followed through the field of view, forwards and then backwards from there. In
// each frame a crop of the ROI's size, at whole sensor pixels about the predicted place (TargetMotion), is registered to the enhanced
// scene; the scene's extent stays the target's, so frames pile up on it. What lies in the ROI's corners and beside the target moves
// differently: pixels lose weight towards the ROI's corners (an ellipse), and residuals are robust.
//
// A registration that cannot be believed (poor correlation, residuals above what is usual for this target, a part of it hidden, a jump
// that the prediction does not allow) makes the frame LOST: it is not added. Then the whole frame is searched for the target's predicted
// picture; a place is accepted on stricter evidence than in tracking, within the uncertainty of the prediction, and only if no other
// place there looks as good. `reason` of the frame's report says what happened, also for a target that has left the field of view or
// that was found again.
//
// The result has one segment, its chain in order of frames; scene_from_sensor maps whole-sensor pixels of each frame to cells, and is
// ratio * (sensor - roi corner) in the reference frame. Memory: one frame and one scene. kInvalidInput, with what to do, when the ROI is
// outside the sensor, too small or without texture to register to, or the reference frame is not usable or not in the range.
Result<EngineResult> RunTarget(const TargetRequest& request, const TargetFrames& frames, const EngineOptions& options,
                               const SnapshotSink& sink, const std::function<bool(double)>& progress);

// Weights of a target's pixels: 1 inside an ellipse that fills most of the ROI, falling to 0.05 in its corners.
Image<float> TargetWeights(int width, int height);

}  // namespace trem
