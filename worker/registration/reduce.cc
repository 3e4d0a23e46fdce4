#include "worker/registration/reduce.h"

#include <algorithm>

namespace trem {
namespace {

template <typename Combine>
Image<float> Reduce(const Image<float>& image, Combine combine) {
  Image<float> half(image.width() / 2, image.height() / 2);
  for (int y = 0; y < half.height(); ++y) {
    const float* a = image.row(2 * y);
    const float* b = image.row(2 * y + 1);
    float* out = half.row(y);
    for (int x = 0; x < half.width(); ++x) out[x] = combine(a[2 * x], a[2 * x + 1], b[2 * x], b[2 * x + 1]);
  }
  return half;
}

}  // namespace

Image<float> ReduceByTwo(const Image<float>& image) {
  return Reduce(image, [](float a, float b, float c, float d) { return 0.25F * (a + b + c + d); });
}

Image<float> ReduceByTwoMinimum(const Image<float>& image) {
  return Reduce(image, [](float a, float b, float c, float d) { return std::min(std::min(a, b), std::min(c, d)); });
}

}  // namespace trem
