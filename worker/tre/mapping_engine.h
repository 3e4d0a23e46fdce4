#pragma once

#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "worker/registration/registration.h"
#include "worker/tre/engine_options.h"

namespace trem {

// One frame of a window, cropped to the ROI.
struct FrameInput {
  int frame_index = 0;                 // In the manifest; reported back.
  std::string skip_reason;             // Not empty: the frame cannot be used, and why.
  Image<float> pixels;                 // roi.width() x roi.height(), internal grey levels; NaN: no measurement.
  Image<float> weights;                // See Observation::weights; empty: all 1.
  // Sensor pixels of this frame to those of the previous usable one, from the registration of whole images; nothing when that failed.
  std::optional<Affine> previous_from_current;
};

// One frame's entry in a segment's chain.
struct ChainEntry {
  int frame_index = 0;
  Registration registration;
};

// A snapshot of the scene, to be composited.
struct SceneSnapshot {
  int scene_id = 0;             // Within the window.
  Roi extent;                   // Cells of the segment's scene plane.
  Image<float> intensity;       // Internal grey levels; 0 where never seen.
  Image<float> information;     // About how many frames have seen each cell; 0: never.
  int frame_begin = 0;          // Manifest frames that were added since the snapshot before: [frame_begin, frame_end).
  int frame_end = 0;
};

struct FrameReport {
  enum class Outcome { kRegistered, kStartedScene, kSkipped, kLost };
  int frame_index = 0;
  Outcome outcome = Outcome::kSkipped;
  std::string reason;
};

struct SegmentResult {
  std::vector<ChainEntry> chain;
};

struct EngineResult {
  std::vector<SegmentResult> segments;
  std::vector<FrameReport> frames;   // One per input frame, in order.
  double noise_sigma = 0.0;          // Internal grey levels.
};

// Receives every snapshot as soon as it is made, so that only one is in memory.
using SnapshotSink = std::function<Status(int segment_id, const SceneSnapshot& snapshot)>;

// Mapping mode: a ROI fixed in the sensor; the scene moves under it by whole cells. For each frame: register to the scene's
// prediction, splat, improve the scene. A segment is a run of frames on one scene plane; it ends, and the next begins a few frames
// earlier, when the view has turned or stretched too far from the first frame's, and it ends without overlap when lock is lost for
// good. Memory is bounded by about 1.5 times the ROI's side: when the ROI moves on, a snapshot is emitted and what lies behind is
// dropped. `progress` (may be empty) is called per frame with the fraction done; false cancels.
Result<EngineResult> RunMapping(const Roi& roi_in_sensor, std::span<const FrameInput> frames, const EngineOptions& options,
                                const SnapshotSink& sink, const std::function<bool(double)>& progress);

}  // namespace trem
