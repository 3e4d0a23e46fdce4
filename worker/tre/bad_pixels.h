#pragma once

#include <vector>

#include "mosaic/base/image.h"
#include "worker/tre/frame_residual.h"

namespace trem {

// Sensor pixels that are persistently wrong: dead, hot, stuck or blinking. While the view moves, a pixel whose residual is an outlier in
// a good part of the frames, and whose neighbours' are not (a thing that the camera follows is wider than one pixel), is bad from then on.
class BadPixels {
 public:
  BadPixels(int width, int height);

  // Learns from a frame whose view moved since the one before. `spread`: sigma of a fixed pattern, internal grey levels, which is no
  // reason to call a pixel bad.
  // Where the frame met no seen scene (ground that comes into view), its neighbours stand in for the prediction.
  void Learn(const Image<float>& frame, const FrameResidual& residual, double noise_sigma, double spread);
  // Decides again. Returns how many were found that were not known.
  int Decide(double noise_sigma, double spread);

  int count() const { return static_cast<int>(list_.size()); }
  // Indices in the ROI (y * width + x), in the order of their finding.
  const std::vector<int>& list() const { return list_; }

 private:
  float Part(int x, int y) const;
  void LearnWithoutScene(const Image<float>& frame, const FrameResidual& residual, float floor2);

  Image<float> tested_;
  Image<float> outliers_;
  Image<float> magnitude_;  // Sum of |residual| over the outliers.
  Image<unsigned char> bad_;
  std::vector<int> list_;
};

}  // namespace trem
