#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "mosaic/base/image.h"
#include "mosaic/base/status.h"
#include "worker/sortie/borders.h"
#include "worker/sortie/frame_statistics.h"
#include "worker/sortie/grey_image.h"
#include "worker/sortie/pixel_mask.h"

namespace trem {

// What the frames of a sortie are measured by.
struct FrameMeasuring {
  int width_px = 0;  // Of most frames.
  int height_px = 0;
  std::optional<double> saturation_level;  // Grey level; nothing: where the frame's number type ends, if it does.
  const PixelMask* mask = nullptr;         // May be null, and then so is `filler`.
  const MaskFiller* filler = nullptr;
};

// What INGEST asks of a frame that it can be told without knowing the others: all of its time but that of registering it to the one before.
struct FrameMeasures {
  Status read;  // What is below holds for a frame that could be read.
  int width_px = 0;
  int height_px = 0;
  double grey_max = 0.0;  // As in GreyImage.
  // For a frame of the right size.
  std::uint64_t fingerprint = 0;
  ValueRange middle;
  bool blank = false;
  // For one that is not blank either; of its masked pixels as they are filled in, but for the count.
  long long saturated_count = 0;
  BorderFinder::LineMeans line_means;
  std::vector<float> sample;  // For QuantileSampler.
  double noise_sigma = 0.0;   // Grey levels.
  Image<float> reduced;       // ReduceFrame.

  bool SizeIs(const FrameMeasuring& by) const { return width_px == by.width_px && height_px == by.height_px; }
};

FrameMeasures MeasureFrame(Result<GreyImage> frame, const FrameMeasuring& by);

}  // namespace trem
