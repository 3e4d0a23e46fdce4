#include "worker/tre/bad_pixels.h"

#include <algorithm>
#include <cmath>
#include <iterator>

namespace trem {
namespace {

constexpr float kOutlierSigmas = 5.0F;
constexpr float kOutliersMin = 4.0F;
constexpr float kOutlierPart = 0.3F;
// A neighbour with this part of outliers counts as wrong too; more than so many of them, and it is no fault of single pixels.
constexpr float kNeighbourPart = 0.2F;
constexpr int kNeighboursMax = 3;

}  // namespace

BadPixels::BadPixels(int width, int height) : tested_(width, height), bad_(width, height) { outliers_ = magnitude_ = tested_; }

void BadPixels::LearnWithoutScene(const Image<float>& frame, const FrameResidual& residual, float floor2) {
  const int right = frame.width() - 1;
  const int bottom = frame.height() - 1;
  for (int y = 0; y <= bottom; ++y) {
    const float* seen = residual.frames_seen.row(y);
    for (int x = 0; x <= right; ++x) {
      if (seen[x] > 0.0F || std::isnan(frame.at(x, y))) continue;
      const float around[] = {frame.at(x > 0 ? x - 1 : 1, y), frame.at(x < right ? x + 1 : right - 1, y), frame.at(x, y > 0 ? y - 1 : 1),
                              frame.at(x, y < bottom ? y + 1 : bottom - 1)};
      const auto [low, high] = std::minmax_element(std::begin(around), std::end(around));
      const float mean = 0.25F * (around[0] + around[1] + around[2] + around[3]);
      // Structure is no reason: half of what the neighbours differ by is expected of the pixel too.
      const float expected2 = floor2 + 0.25F * (*high - *low) * (*high - *low);
      const float size = std::abs(frame.at(x, y) - mean);
      if (!(size < 1e9F)) continue;
      tested_.at(x, y) += 1.0F;
      if (!(size * size > kOutlierSigmas * kOutlierSigmas * expected2)) continue;
      outliers_.at(x, y) += 1.0F;
      magnitude_.at(x, y) += size;
    }
  }
}

void BadPixels::Learn(const Image<float>& frame, const FrameResidual& residual, double noise_sigma, double spread) {
  const float spread2 = static_cast<float>(spread * spread);
  // Rounding to whole grey levels and a share of the noise that is not known make a floor.
  const float floor2 = static_cast<float>(noise_sigma * noise_sigma) + 0.25F;
  for (int y = 0; y < tested_.height(); ++y) {
    const float* value = residual.value.row(y);
    const float* variance = residual.variance.row(y);
    float* tested = tested_.row(y);
    float* outliers = outliers_.row(y);
    float* magnitude = magnitude_.row(y);
    for (int x = 0; x < tested_.width(); ++x) {
      const float size = std::abs(value[x]);
      const bool usable = size < 1e9F;
      const bool outlier = usable && size * size > kOutlierSigmas * kOutlierSigmas * (std::max(variance[x], floor2) + spread2);
      tested[x] += usable ? 1.0F : 0.0F;
      outliers[x] += outlier ? 1.0F : 0.0F;
      magnitude[x] += outlier ? size : 0.0F;
    }
  }
  LearnWithoutScene(frame, residual, floor2 + spread2);
}

float BadPixels::Part(int x, int y) const { return tested_.at(x, y) > 0.0F ? outliers_.at(x, y) / tested_.at(x, y) : 0.0F; }

int BadPixels::Decide(double noise_sigma, double spread) {
  const float least = kOutlierSigmas * static_cast<float>(std::hypot(noise_sigma, spread));
  int found = 0;
  for (int y = 0; y < tested_.height(); ++y) {
    for (int x = 0; x < tested_.width(); ++x) {
      if (outliers_.at(x, y) < kOutliersMin || bad_.at(x, y) != 0) continue;
      if (Part(x, y) < kOutlierPart || magnitude_.at(x, y) < least * outliers_.at(x, y)) continue;
      int neighbours = 0;
      for (int j = std::max(y - 1, 0); j <= std::min(y + 1, tested_.height() - 1); ++j) {
        for (int i = std::max(x - 1, 0); i <= std::min(x + 1, tested_.width() - 1); ++i) neighbours += Part(i, j) > kNeighbourPart ? 1 : 0;
      }
      if (neighbours - 1 > kNeighboursMax) continue;
      bad_.at(x, y) = 1;
      list_.push_back(y * tested_.width() + x);
      ++found;
    }
  }
  return found;
}

}  // namespace trem
