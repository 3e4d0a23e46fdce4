// Goal: the vectorised row filters give exactly the bytes that their header promises, on every SIMD target, and touch nothing else.
// Method: a scalar loop with std::fma in the promised order, for all row lengths about the vectors' widths; guard values after the end.
#include "worker/sensor/filter_rows.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "tests/support/simd_targets.h"
#include "tests/unit/worker/sensor/random_image.h"
#include "worker/sensor/reflect.h"

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

// Element k of the sum about `centre`, in the stated order; at(k) is the k-th value to either side.
template <class At>
float FusedSum(const std::vector<float>& taps, const At& at) {
  float sum = taps[0] * at(0);
  for (int k = 1; k < static_cast<int>(taps.size()); ++k) sum = std::fma(taps[static_cast<std::size_t>(k)], at(-k) + at(k), sum);
  return sum;
}

TEST(FilterRows, ABlockIsFilteredBothWaysInTheStatedOrderOnEveryTarget) {
  constexpr int kRows = 6;  // Groups of four and of two, and single rows.
  for (const std::int64_t target : testing::FusedTargets()) {
    const testing::WithTarget chosen(target);
    for (const int radius : {0, 1, 6, 9, 17}) {
      const std::vector<float> taps = Taps(radius);
      for (int width = 1; width <= 150; width += width < 40 ? 1 : 7) {
        const Image<float> image = RandomImage(width, kRows + 2 * radius, 8);
        const int begin = width > 60 ? 37 : width / 3;
        const int end = width % 2 == 0 ? width : std::max(width - 9, begin + 1);
        FilterBlock block;
        std::vector<const float*> rows;
        for (int j = 0; j < image.height(); ++j) rows.push_back(image.row(j));
        block.rows = rows.data();
        block.row_count = kRows;
        block.taps = taps.data();
        block.radius = radius;
        block.begin = begin;
        block.end = end;
        block.width = width;
        block.first = std::max(begin - radius, 0);
        block.stride = radius + kRowSlack + width + radius + kRowSlack;
        std::vector<float> lines(static_cast<std::size_t>(block.stride) * kFilterLines);
        block.lines = lines.data() + radius + kRowSlack;
        Image<float> out(width + 1, kRows, kGuard);
        std::vector<float*> out_rows;
        for (int i = 0; i < kRows; ++i) out_rows.push_back(out.row(i));
        FilterRows(block, out_rows.data());
        for (int i = 0; i < kRows; ++i) {
          const auto down = [&](int x) { return FusedSum(taps, [&](int k) { return image.at(ReflectIndex(x, width), i + radius + k); }); };
          for (int x = 0; x <= width; ++x) {
            const bool wanted = x >= begin && x < end;
            const float expected = wanted ? FusedSum(taps, [&](int k) { return down(x + k); }) : kGuard;
            ASSERT_EQ(out.at(x, i), expected) << hwy::TargetName(target) << " radius " << radius << " width " << width << " at " << x
                                              << ", " << i;
          }
        }
      }
    }
  }
}

}  // namespace
}  // namespace trem
