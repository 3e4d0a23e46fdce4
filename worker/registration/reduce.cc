#include "worker/registration/reduce.h"

#include <algorithm>
#include <cmath>

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

WeightedImage ReduceByTwoWeighted(const Image<float>& image, const Image<float>* weights) {
  WeightedImage half{Image<float>(image.width() / 2, image.height() / 2), Image<float>(image.width() / 2, image.height() / 2)};
  for (int y = 0; y < half.pixels.height(); ++y) {
    for (int x = 0; x < half.pixels.width(); ++x) {
      float sum = 0.0F;
      float total = 0.0F;
      float largest = 0.0F;
      for (int k = 0; k < 4; ++k) {
        const int u = 2 * x + k % 2;
        const int v = 2 * y + k / 2;
        const float pixel = image.at(u, v);
        const float weight = weights != nullptr ? weights->at(u, v) : 1.0F;
        if (std::isnan(pixel) || !(weight > 0.0F)) continue;
        sum += weight * pixel;
        total += weight;
        largest = std::max(largest, weight);
      }
      if (!(total >= 2.0F * largest) || !(total > 0.0F)) continue;
      half.pixels.at(x, y) = sum / total;
      half.weights.at(x, y) = 0.25F * total;
    }
  }
  return half;
}

Image<float> ReduceByTwoMinimum(const Image<float>& image) {
  return Reduce(image, [](float a, float b, float c, float d) { return std::min(std::min(a, b), std::min(c, d)); });
}

}  // namespace trem
