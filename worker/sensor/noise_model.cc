#include "worker/sensor/noise_model.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace trem {
namespace {

constexpr int kReach_px = 2;

struct Sum {
  double value = 0.0;
  int count = 0;
};

}  // namespace

Image<float> NoiseWeights(const Image<float>& frame, const NoiseModel& model) {
  Image<float> weights(frame.width(), frame.height());
  std::vector<Sum> columns(static_cast<std::size_t>(frame.width()));
  for (int y = 0; y < frame.height(); ++y) {
    std::fill(columns.begin(), columns.end(), Sum());
    for (int j = std::max(y - kReach_px, 0); j <= std::min(y + kReach_px, frame.height() - 1); ++j) {
      for (int x = 0; x < frame.width(); ++x) {
        const float value = frame.at(x, j);
        if (std::isnan(value)) continue;
        columns[static_cast<std::size_t>(x)].value += value;
        ++columns[static_cast<std::size_t>(x)].count;
      }
    }
    for (int x = 0; x < frame.width(); ++x) {
      const float own = frame.at(x, y);
      if (std::isnan(own)) continue;
      Sum around{-own, -1};
      for (int i = std::max(x - kReach_px, 0); i <= std::min(x + kReach_px, frame.width() - 1); ++i) {
        around.value += columns[static_cast<std::size_t>(i)].value;
        around.count += columns[static_cast<std::size_t>(i)].count;
      }
      const double level = around.count > 0 ? around.value / around.count : own;
      weights.at(x, y) = static_cast<float>(model.typical_variance / model.Variance(level));
    }
  }
  return weights;
}

}  // namespace trem
