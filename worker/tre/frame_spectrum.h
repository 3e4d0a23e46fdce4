#pragma once

#include <Eigen/Core>
#include <vector>

#include "mosaic/base/image.h"

namespace trem {

// The power spectrum of a sortie's frames, averaged over tiles (Welch's method): tiles of kSide x kSide px that overlap by half, without
// their mean, under a Hann window.
class FrameSpectrum {
 public:
  static constexpr int kSide = 64;

  // A frequency [cycles a sensor pixel, -1/2 .. 1/2; y down] and the mean power there [grey levels^2]: white noise of variance v has
  // power v everywhere.
  struct Bin {
    double fx = 0.0;
    double fy = 0.0;
    double power = 0.0;
  };

  // Adds the tiles of a frame. NaN pixels are filled from their neighbours; a tile with more than 2 % of them is left out.
  void Add(const Image<float>& pixels);

  int tile_count() const { return tile_count_; }

  // One of each pair of opposite frequencies, without the axes (on which borders of tiles, detector rows and interlacing leave their
  // marks) and without those below `frequency_min`.
  std::vector<Bin> Bins(double frequency_min) const;

 private:
  Eigen::ArrayXXd power_sum_ = Eigen::ArrayXXd::Zero(kSide, kSide);  // Rows along fy.
  int tile_count_ = 0;
};

}  // namespace trem
