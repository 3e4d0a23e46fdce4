#include "worker/simulate/surface.h"

#include <algorithm>
#include <cmath>

#include "mosaic/base/check.h"

namespace trem {
namespace {

// Turns `count` samples, `stride` apart, into cubic B-spline coefficients in place (mirror boundaries).
void FilterLine(double* line, std::ptrdiff_t stride, int count) {
  if (count == 1) return;
  const double pole = std::sqrt(3.0) - 2.0;
  const double gain = (1.0 - pole) * (1.0 - 1.0 / pole);
  for (int i = 0; i < count; ++i) line[i * stride] *= gain;
  // The first causal coefficient is the sum over the mirrored past; |pole|^28 < 1e-16.
  const int horizon = std::min(count, 28);
  double sum = line[0];
  double power = pole;
  for (int i = 1; i < horizon; ++i, power *= pole) sum += power * line[i * stride];
  line[0] = sum;
  for (int i = 1; i < count; ++i) line[i * stride] += pole * line[(i - 1) * stride];
  line[(count - 1) * stride] = pole / (pole * pole - 1.0) * (line[(count - 1) * stride] + pole * line[(count - 2) * stride]);
  for (int i = count - 2; i >= 0; --i) line[i * stride] = pole * (line[(i + 1) * stride] - line[i * stride]);
}

// Mirror without repeating the border sample.
int Mirror(int i, int count) {
  if (count == 1) return 0;
  const int period = 2 * (count - 1);
  i = ((i % period) + period) % period;
  return i < count ? i : period - i;
}

void CubicWeights(double t, double* w) {
  const double s = 1.0 - t;
  w[0] = s * s * s / 6.0;
  w[1] = 2.0 / 3.0 - 0.5 * t * t * (2.0 - t);
  w[2] = 2.0 / 3.0 - 0.5 * s * s * (2.0 - s);
  w[3] = t * t * t / 6.0;
}

}  // namespace

SplineSurface::SplineSurface(const Image<float>& image) : width_(image.width()), height_(image.height()) {
  TREM_CHECK(!image.empty());
  std::vector<double> work(image.pixels().begin(), image.pixels().end());
  for (int y = 0; y < height_; ++y) FilterLine(work.data() + static_cast<std::size_t>(y) * width_, 1, width_);
  for (int x = 0; x < width_; ++x) FilterLine(work.data() + x, width_, height_);
  stride_ = static_cast<std::size_t>(width_) + 2 * kBorder;
  coefficients_.resize(stride_ * (static_cast<std::size_t>(height_) + 2 * kBorder));
  for (int y = -kBorder; y < height_ + kBorder; ++y) {
    const double* source = work.data() + static_cast<std::size_t>(Mirror(y, height_)) * width_;
    float* target = coefficients_.data() + static_cast<std::size_t>(y + kBorder) * stride_ + kBorder;
    for (int x = -kBorder; x < width_ + kBorder; ++x) target[x] = static_cast<float>(source[Mirror(x, width_)]);
  }
}

double SplineSurface::At(double x, double y) const {
  TREM_CHECK(x >= -1.0 && y >= -1.0 && x <= width_ && y <= height_);
  const double floor_x = std::floor(x);
  const double floor_y = std::floor(y);
  double wx[4];
  double wy[4];
  CubicWeights(x - floor_x, wx);
  CubicWeights(y - floor_y, wy);
  const float* row = coefficients_.data() + static_cast<std::size_t>(static_cast<int>(floor_y) - 1 + kBorder) * stride_ +
                     static_cast<std::size_t>(static_cast<int>(floor_x) - 1 + kBorder);
  double sum = 0.0;
  for (int j = 0; j < 4; ++j, row += stride_) sum += wy[j] * (wx[0] * row[0] + wx[1] * row[1] + wx[2] * row[2] + wx[3] * row[3]);
  return sum;
}

}  // namespace trem
