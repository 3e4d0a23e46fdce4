#pragma once

#include <functional>
#include <optional>
#include <vector>

#include "mosaic/geometry/roi.h"
#include "worker/app/published_scene.h"

namespace trem {

// How fine a scene of so many frames is.
struct ResolutionPoint {
  int frame_count = 0;
  double cycles_per_px = 0.0;  // Sensor pixels; ratio / 2 is the most that the scene grid can show.
};

// Enhances frames [begin, end) alone; with `target`, the ROI was picked in that frame.
using EnhanceFrames = std::function<Result<v1::WindowResult>(int begin, int end, const Roi& roi, std::optional<int> target)>;

// Resolution against the number of frames, measured without truth: the last 2, 4, 8 ... frames of the published scene are parted into an
// earlier and a later half, each half makes a scene of its own, and the frequency up to which the two agree (AgreementLimit) is what a
// scene of both resolves. The halves share nothing but the views that say where one lies in the other.
//
// Ends where the halves look at too different ground, where a half loses lock, or at `frames_max` frames. Empty for ROIs below 64 cells.
Result<std::vector<ResolutionPoint>> ResolutionByFrames(const EnhancedWindow& enhanced, const PublishedScene& published, int frames_max,
                                                        const EnhanceFrames& enhance);

}  // namespace trem
