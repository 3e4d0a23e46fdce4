#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "mosaic/base/image.h"
#include "mosaic/base/status.h"
#include "mosaic/geometry/roi.h"
#include "proto/trem/v1/job.pb.h"

namespace trem {

// Which pixels of the sensor are ever used: 1 usable, 0 not.
struct PixelMask {
  Image<std::uint8_t> usable;
  long long unusable_count = 0;
  Roi usable_bounds;  // The smallest rectangle with every usable pixel.
};

// Reads sensor.mask_path (zero: no image) and sensor.bad_pixel_path (not zero: bad); nothing when neither is set. kInvalidInput names the
// field and the file when it is no PNG or TIFF of exactly the sensor's size (what was found, what was expected), or when nothing usable is left.
Result<std::optional<PixelMask>> ReadPixelMask(const v1::Sensor& sensor, int width_px, int height_px);

// A mask as the lengths of alternating runs in row-major order, beginning with usable pixels (0 when the first is not), and back.
// kCorrupt when the runs do not add up to the sensor.
std::vector<std::uint32_t> RunsOf(const PixelMask& mask);
Result<Image<std::uint8_t>> UsableFromRuns(std::span<const std::uint32_t> runs, int width_px, int height_px);

// Gives unusable pixels the mean of the usable ones about them (boxes of 3, 9, 33, 129 px, the first that holds one), for what works on
// whole images and cannot leave pixels out: what is filled in is smooth, so that a band-pass leaves nothing of it to register.
class MaskFiller {
 public:
  explicit MaskFiller(const PixelMask& mask);
  void Fill(Image<float>* frame) const;

 private:
  struct Scale {
    int side_px = 0;
    std::vector<std::uint32_t> pixels;  // Indices of the pixels filled at this scale.
    std::vector<float> usable_counts;   // Usable pixels in the box about each.
  };
  Image<float> usable_;
  std::vector<Scale> scales_;
  std::vector<std::uint32_t> others_;   // Farther from any usable pixel: filled with the frame's mean.
};

}  // namespace trem
