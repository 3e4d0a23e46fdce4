// Goal: the vectorised row filters give exactly the bytes that their header promises, on every SIMD target, and touch nothing else.
// Method: a scalar loop with std::fma in the promised order, for all row lengths about the vectors' widths; guard values after the end.
#include "worker/sensor/filter_rows.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/support/simd_targets.h"
#include "tests/unit/worker/sensor/random_image.h"

namespace trem {
namespace {

constexpr float kGuard = -12345.0F;

std::vector<float> Taps(int radius) {
  std::vector<float> taps;
  for (int k = 0; k <= radius; ++k) taps.push_back(1.0F / (1.7F + static_cast<float>(k)));
  return taps;
}

TEST(FilterRows, ColumnsAreTheFusedSumInTheStatedOrderOnEveryTarget) {
  for (const std::int64_t target : testing::FusedTargets()) {
    const testing::WithTarget chosen(target);
    for (const int radius : {0, 1, 6, 17}) {
      const std::vector<float> taps = Taps(radius);
      for (int count = 1; count <= 150; ++count) {
        const Image<float> image = RandomImage(count, 2 * radius + 1, 7);
        std::vector<const float*> rows;
        for (int j = 0; j <= 2 * radius; ++j) rows.push_back(image.row(j));
        std::vector<float> out(static_cast<std::size_t>(count) + 1, kGuard);
        FilterColumns(rows.data(), taps.data(), radius, count, out.data());
        for (int x = 0; x < count; ++x) {
          float sum = taps[0] * image.at(x, radius);
          for (int k = 1; k <= radius; ++k) {
            sum = std::fma(taps[static_cast<std::size_t>(k)], image.at(x, radius - k) + image.at(x, radius + k), sum);
          }
          ASSERT_EQ(out[static_cast<std::size_t>(x)], sum)
              << hwy::TargetName(target) << " radius " << radius << " count " << count << " x " << x;
        }
        ASSERT_EQ(out.back(), kGuard);
      }
    }
  }
}

TEST(FilterRows, RowsAreTheFusedSumInTheStatedOrderOnEveryTarget) {
  for (const std::int64_t target : testing::FusedTargets()) {
    const testing::WithTarget chosen(target);
    for (const int radius : {0, 1, 6, 17}) {
      const std::vector<float> taps = Taps(radius);
      for (int count = 1; count <= 150; ++count) {
        const Image<float> image = RandomImage(count + 2 * radius + kRowSlack, 1, 8);
        const float* in = image.row(0) + radius;
        std::vector<float> out(static_cast<std::size_t>(count) + 1, kGuard);
        FilterRow(in, taps.data(), radius, count, out.data());
        for (int x = 0; x < count; ++x) {
          float sum = taps[0] * in[x];
          for (int k = 1; k <= radius; ++k) sum = std::fma(taps[static_cast<std::size_t>(k)], in[x - k] + in[x + k], sum);
          ASSERT_EQ(out[static_cast<std::size_t>(x)], sum)
              << hwy::TargetName(target) << " radius " << radius << " count " << count << " x " << x;
        }
        ASSERT_EQ(out.back(), kGuard);
      }
    }
  }
}

}  // namespace
}  // namespace trem
