#pragma once

#include <optional>
#include <string>

#include "mosaic/base/image.h"
#include "mosaic/geometry/affine.h"
#include "mosaic/geometry/roi.h"

namespace trem {

// One frame of a window, cropped to the ROI.
struct FrameInput {
  int frame_index = 0;      // In the manifest; reported back.
  std::string skip_reason;  // Not empty: the frame cannot be used, and why.
  std::optional<Roi> roi;   // Where in the sensor `pixels` lie; none: the window's ROI.
  Image<float> pixels;      // roi.width() x roi.height(), internal grey levels; NaN: no measurement.
  Image<float> weights;     // See Observation::weights; empty: all 1.
  // Sensor pixels of this frame to those of the previous usable one, from the registration of whole images; nothing when that failed.
  std::optional<Affine> previous_from_current;
};

}  // namespace trem
