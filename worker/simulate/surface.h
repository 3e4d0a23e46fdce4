#pragma once

#include <cstddef>
#include <vector>

#include "mosaic/base/image.h"

namespace trem {

// A continuous surface through the samples of an image: the interpolating cubic B-spline
//
//   s(x, y) = sum_ij c_ij beta3(x - i) beta3(y - j),   s(i, j) = image(i, j),
//
// with mirror boundaries. Pixel coordinates; (0, 0) is the centre of the upper left pixel. Chosen over a cubic convolution because its
// response stays within 1% of one up to half of the Nyquist frequency. Source: Unser, "Splines: a perfect fit for signal and image
// processing", IEEE Signal Processing Magazine 16(6), 1999.
class SplineSurface {
 public:
  SplineSurface() = default;
  // Cost: two recursive passes over the image.
  explicit SplineSurface(const Image<float>& image);

  int width() const { return width_; }
  int height() const { return height_; }
  // The surface at (x, y). Precondition: -1 <= x <= width, -1 <= y <= height, so that mirrored coefficients reach. Cost: 16 products.
  double At(double x, double y) const;

 private:
  static constexpr int kBorder = 3;  // Mirrored coefficients kept on every side.
  int width_ = 0;
  int height_ = 0;
  std::size_t stride_ = 0;
  std::vector<float> coefficients_;
};

}  // namespace trem
