#pragma once

#include <string>

#include "worker/tre/bad_pixels.h"
#include "worker/tre/detector_bias.h"
#include "worker/tre/frame_input.h"

namespace trem {

// What a window learns of its detector and removes from every frame before it is used: fixed pattern and bad pixels. Lives as long as the
// window, over all of its scenes.
class SensorCorrections {
 public:
  SensorCorrections(const Roi& roi, Correction mode);

  // Subtracts the pattern; bad pixels get weight 0 and the mean of their good neighbours.
  void Correct(FrameInput* frame) const;
  // Learns from a registered frame that Correct has seen.
  void Learn(const FrameInput& frame, const FrameResidual& residual, const View& view, double noise_sigma);
  // A new scene plane begins.
  void BreakTrack() { bias_.BreakTrack(); }
  // True once, when enough is known for the first time that the frames since the beginning are worth seeing again.
  bool WorthRevisiting();

  const std::vector<int>& bad_pixels() const { return bad_.list(); }
  // What was found, in words; empty: nothing.
  std::string BiasNote() const;
  std::string BadPixelNote() const;

 private:
  Roi roi_;
  Correction mode_;
  DetectorBias bias_;
  BadPixels bad_;
  int learned_ = 0;
  bool revisited_ = false;
};

}  // namespace trem
