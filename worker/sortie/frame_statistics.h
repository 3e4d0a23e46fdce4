#pragma once

#include <cstdint>
#include <vector>

#include "mosaic/base/image.h"
#include "mosaic/geometry/roi.h"

namespace trem {

// Standard deviation of a frame's white noise, in its grey levels: Immerkaer's Laplacian (CVIU 64(2), 1996: sigma = sqrt(pi/2) / 6 *
// mean |I * [1 -2 1; -2 4 -2; 1 -2 1]|) over blocks of 16 x 16 px, of which a low quantile is taken because texture only adds. Unbiased
// (within 3 %) on pure noise. 0 for frames smaller than a block. Blocks with a pixel that `usable` (may be null) says 0 of are left out.
double EstimateNoiseSigma(const Image<float>& frame, const Roi& roi, const Image<std::uint8_t>* usable = nullptr);

// Identifies a frame's exact pixels (64-bit FNV-1a over size and bit patterns).
std::uint64_t PixelFingerprint(const Image<float>& frame);

// Smallest and largest value of a frame's middle (60 % of each side).
struct ValueRange {
  float low = 0.0F;
  float high = 0.0F;
};
ValueRange MiddleRange(const Image<float>& frame);

// Quantiles of all pixels of many frames from a bounded, evenly thinned sample (at most 2^20 values).
class QuantileSampler {
 public:
  // The pixels that a frame would give to the sample.
  static std::vector<float> PixelsOf(const Image<float>& frame);
  void Add(const std::vector<float>& pixels);
  void Add(const Image<float>& frame) { Add(PixelsOf(frame)); }
  // `p` in [0, 1], counted above the darkest `skipped` part of the sample (black borders). 0 without values.
  double Quantile(double p, double skipped) const;

 private:
  std::vector<float> values_;
  int frame_stride_ = 1;  // Every frame_stride_-th frame is sampled.
  int frame_count_ = 0;
};

// How the source's grey levels map to the engine's: source = offset + scale * internal.
struct GreyScaling {
  double offset = 0.0;
  double scale = 1.0;
};
// 8-bit sources (grey_max 255) stay as they are. For others the 0.5 % and 99.5 % quantiles become 10 and 245.
GreyScaling ChooseGreyScaling(double grey_max, const QuantileSampler& sampler, double border_part);

}  // namespace trem
