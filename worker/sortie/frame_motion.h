#pragma once

#include <array>
#include <memory>
#include <optional>

#include "mosaic/base/image.h"
#include "mosaic/geometry/affine.h"
#include "mosaic/geometry/roi.h"

namespace trem {

// A frame area-averaged to at most kReducedSide_px a side: what registration works on and what may be kept of a frame while many are
// waiting.
inline constexpr int kReducedSide_px = 384;
Image<float> ReduceFrame(const Image<float>& frame);

// How two successive frames lie to each other.
struct MotionLink {
  // Sensor pixels of the current frame to those of the previous one.
  Affine previous_from_current;
  double correlation = 0.0;  // Normalised, of the band-passed frames over their overlap, 0..1.
  double overlap = 0.0;      // Part of the current frame that the previous one covers, 0..1.
};

// Registers every frame to the one before it, whole image, without any prior knowledge but that the ground is seen again: frames may
// differ by shifts of a large part of their size, by rotation, scale, gain and offset. Used as a motion prior and to detect cuts.
//
// Method: frames are band-passed (gain, offset and smooth shading cancel) on a pyramid of about 96, 192 and 384 px. From the coarsest level
// on, the last motion is refined by ECC (Evangelidis & Psarakis, PAMI 30(10), 2008). Where the result does not correlate well, or phase
// correlation, which knows nothing of it, finds another shift, that shift and no motion at all are refined too, and what correlates best
// counts. When that is poor, SIFT features with a RANSAC affine fit are tried as a further start. A result counts when its correlation,
// overlap, scale and shear are plausible.
class FrameMotion {
 public:
  // Size of the frames in sensor pixels, and the part of them without black borders.
  FrameMotion(int width_px, int height_px, const Roi& valid_roi);
  ~FrameMotion();
  FrameMotion(FrameMotion&&) noexcept;
  FrameMotion& operator=(FrameMotion&&) noexcept;

  // `reduced` = ReduceFrame(frame). Nothing for the first frame and when no plausible registration to the previous frame exists (a cut).
  // Either way the frame becomes the previous one. About 15 ms a frame.
  std::optional<MotionLink> Link(const Image<float>& reduced);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace trem
