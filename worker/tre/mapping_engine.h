#pragma once

#include <functional>
#include <span>
#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "worker/registration/registration.h"
#include "worker/tre/engine_options.h"
#include "worker/tre/frame_input.h"

namespace trem {

// One frame's entry in a segment's chain.
struct ChainEntry {
  int frame_index = 0;
  Registration registration;
  std::optional<Roi> roi = std::nullopt;  // The frame's ROI, when it is not the window's: its corners are those of the covariance.
};

// A snapshot of the scene, to be composited.
struct SceneSnapshot {
  int scene_id = 0;          // Within the window.
  Roi extent;                // Cells of the segment's scene plane.
  Image<float> intensity;    // InEmittedBand of the scene; internal grey levels; 0 where never seen.
  Image<float> information;  // About how many frames have seen each cell; 0: never.
  // With EngineOptions::uncertainty, else empty; internal grey levels, 0 where never seen.
  Image<float> sigma;     // Standard deviation of the intensity's error, see SceneSigma.
  Image<float> residual;  // Robust rms of the frames' residuals.
  int frame_begin = 0;    // Manifest frames that were added since the snapshot before: [frame_begin, frame_end).
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

// What the engine found out about the frames and corrected by itself.
struct EngineNote {
  std::string code;      // Stable identifier, for example "brightness_jump".
  int frame_index = -1;  // In the manifest; -1: the whole window.
  std::string text;
};

struct EngineResult {
  std::vector<SegmentResult> segments;
  std::vector<FrameReport> frames;  // One per input frame, in order.
  std::vector<EngineNote> notes;    // In the order of the frames.
  double noise_sigma = 0.0;         // Internal grey levels.
  std::vector<int> bad_pixels;      // Found by the engine: indices in the ROI, y * width + x.
  long long masked_pixels = 0;      // Masked as moving, of used_pixels.
  long long used_pixels = 0;
};

// Receives every snapshot as soon as it is made, so that only one is in memory.
using SnapshotSink = std::function<Status(int segment_id, const SceneSnapshot& snapshot)>;

// Whether TRE can run on such a ROI with such options; kInvalidInput says what to change.
Status CheckEngine(const Roi& roi, const EngineOptions& options);

// Mapping mode: a ROI fixed in the sensor; the scene moves under it by whole cells. For each frame: register to the scene's
// prediction, splat, improve the scene. A segment is a run of frames on one scene plane; it ends, and the next begins a few frames
// earlier, when the view has turned or stretched too far from the first frame's, and it ends without overlap when lock is lost for
// good, when the frames that follow show something else (a cut), or when a frame's motion has left less of the ROI over the scene than
// registering needs. Memory is bounded by about 1.5 times the ROI's side: when the ROI moves on, a snapshot is emitted and what lies behind
// is dropped. `progress` (may be empty) is called per frame with the fraction done; false cancels.
Result<EngineResult> RunMapping(const Roi& roi_in_sensor, std::span<const FrameInput> frames, const EngineOptions& options,
                                const SnapshotSink& sink, const std::function<bool(double)>& progress);

}  // namespace trem
