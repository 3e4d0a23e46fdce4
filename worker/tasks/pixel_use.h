#pragma once

#include <optional>

#include "mosaic/base/image.h"
#include "mosaic/base/status.h"
#include "mosaic/geometry/roi.h"
#include "proto/trem/v1/job.pb.h"
#include "proto/trem/v1/task.pb.h"
#include "worker/sensor/noise_model.h"
#include "worker/tre/mapping_engine.h"

namespace trem {

// What of a frame's ROI is used, and how much it counts: masked and bad pixels become NaN; saturated ones keep their value with a
// twentieth of the weight (they still say that it is bright there, so that a clipped roof is no hole, and are too weak to bend anything);
// photon noise weighs every pixel. What the sensor's vignetting took is given back, and its noise, which grows with that, counts less.
class PixelUse {
 public:
  static Result<PixelUse> Of(const v1::Sensor& sensor, const v1::SortieManifest& manifest);

  // Takes `roi` of a whole frame [grey levels of the source] into frame->pixels [internal ones]; frame->weights only when they are not
  // all 1.
  void Take(const Image<float>& whole, const Roi& roi, FrameInput* frame) const;
  // Part of the ROI's pixels that are not masked.
  double UsablePart(const Roi& roi) const;

 private:
  void Weigh(FrameInput* frame) const;
  void UndoVignetting(const Roi& roi, FrameInput* frame) const;

  PixelUse() = default;

  Image<std::uint8_t> usable_;  // Empty: all.
  Image<float> brightening_;    // Empty: no vignetting.
  double grey_offset_ = 0.0;
  double grey_scale_ = 1.0;
  std::optional<float> saturation_level_;  // Internal grey levels.
  std::optional<NoiseModel> noise_;        // Grey levels above black; nothing when the noise is constant.
  float black_ = 0.0F;                     // Internal grey level of the source's 0.
};

// A window with less of its ROI usable is not worth registering.
inline constexpr double kUsablePartMin = 0.1;

}  // namespace trem
