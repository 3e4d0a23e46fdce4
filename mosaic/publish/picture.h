#pragma once

#include <string>
#include <vector>

#include "mosaic/base/image.h"
#include "mosaic/base/status.h"
#include "mosaic/geometry/roi.h"

namespace trem {

// A reduced picture of a large raster that arrives in rectangles: each picture pixel is the mean of the finite values of a block of
// `factor` x `factor` raster pixels (fewer at the right and lower edges), NaN where there are none. `factor` is the least whole number
// that makes the picture fit `side_max`. Memory: 12 bytes a picture pixel.
class Reduction {
 public:
  // Preconditions: width, height, side_max >= 1.
  Reduction(int width, int height, int side_max);

  // Adds the pixels of `roi`; every raster pixel at most once. `plane` has roi's size. The sums of a block are formed in the order of
  // calls: feed rectangles in a fixed order for the same bytes each time.
  void Add(const Roi& roi, const Image<float>& plane);
  Image<float> Picture() const;
  int factor() const { return factor_; }

 private:
  int factor_ = 1;
  Image<double> sum_;
  Image<int> count_;
};

struct ValueRange {
  double low = 0.0;
  double high = 1.0;
};

// The range between two quantiles (each in [0, 1], low <= high) of the finite pixels, widened to at least 1e-6; {0, 1} when there are none.
ValueRange QuantileRange(const Image<float>& picture, double low, double high);

// An 8-bit PNG with transparency where the picture is not finite: grey, from black at range.low to white at range.high. The bytes
// depend on the arguments only.
Result<std::string> GreyPng(const Image<float>& picture, const ValueRange& range);
// The same in OpenCV's viridis colours, dark blue to yellow.
Result<std::string> ColourPng(const Image<float>& picture, const ValueRange& range);

// RFC 4648, section 4.
std::string Base64(const std::string& bytes);

}  // namespace trem
