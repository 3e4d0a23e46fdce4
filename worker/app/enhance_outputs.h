#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "worker/app/resolution_curve.h"

namespace trem {

struct EnhanceSummary {
  int reference_index = 0;
  std::string reference_name;
  int frame_count = 0;
  int registered_count = 0;  // Started scenes included.
  int lost_count = 0;
  int skipped_count = 0;
  int segment_count = 0;
  double noise_sigma = 0.0;                    // Grey levels of the source.
  std::vector<ResolutionPoint> resolution;     // Against the number of frames; may be empty.
  std::vector<std::filesystem::path> outputs;  // The scene first.
  std::vector<std::string> notes;
};

// Where the files go: STEM.tif as asked for, STEM_chain.csv, STEM_comparison.png and STEM_report.html beside it.
std::vector<std::filesystem::path> EnhanceOutputPaths(const std::filesystem::path& scene_path);

// Publishes the last scene of the window's last segment, atomically, the scene itself last:
//
//   scene        bands intensity, standard deviation of its error, information [about how many frames] and robust rms of the residuals
//                [grey levels of the source; NaN: never seen]. Its geotransform maps to sensor pixels of the reference frame,
//                corner-based: x right, y down, (0, 0) the frame's upper left corner.
//   chain        one row per frame and segment: status, scene_from_sensor, gain, offset, residuals, covariances
//   comparison   left the reference frame's ROI enlarged bicubically, right the scene in the same view, in the same stretch of grey
//   report       a self-contained page with these pictures, figures, and charts of the chain
//
// How resolution grows with the frames is measured with up to `resolution_frames` of them, by `enhance` (0: not at all).
// `reference` is a manifest index (none: the last frame of that segment). kInvalidInput names the frames to choose from when it is not
// registered there; kFailed when the window has no scene at all.
Result<EnhanceSummary> PublishEnhancedScene(const EnhancedWindow& enhanced, std::optional<int> reference,
                                            const std::filesystem::path& scene_path, int resolution_frames, const EnhanceFrames& enhance);

}  // namespace trem
