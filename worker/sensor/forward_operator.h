#pragma once

#include "mosaic/base/image.h"
#include "mosaic/geometry/affine.h"
#include "worker/sensor/blur.h"

namespace trem {

// The linear part A of the sensor model for one view:
//
//   (A S)(u) = (B S)(scene_from_sensor * u),   S in R^{scene height x width}, A S in R^{frame height x width}
//
// B: Blur; sampled by Keys' bicubic. Frame pixels whose 4x4 support leaves the scene are 0 and carry no information.
// Cost: one Blur of the scene and 16 multiply-adds a frame pixel.
class ForwardOperator {
 public:
  ForwardOperator(Psf psf, const Affine& scene_from_sensor, int frame_width, int frame_height)
      : blur_(std::move(psf)), scene_from_sensor_(scene_from_sensor), frame_width_(frame_width), frame_height_(frame_height) {}

  Image<float> Apply(const Image<float>& scene);
  // A' y, exactly: <A x, y> == <x, A' y> up to rounding.
  Image<float> ApplyAdjoint(const Image<float>& frame, int scene_width, int scene_height);

 private:
  Blur blur_;
  Affine scene_from_sensor_;
  int frame_width_;
  int frame_height_;
};

}  // namespace trem
