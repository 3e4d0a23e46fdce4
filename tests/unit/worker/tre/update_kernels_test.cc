// Goal: what the scene update asks of a row is answered alike on every SIMD target, at every length. Method: plain loops over rows of
// random values; the sums of different targets must agree to the byte.
#include "worker/tre/update_kernels.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>

#include "tests/support/simd_targets.h"
#include "tests/unit/worker/sensor/random_image.h"

namespace trem {
namespace {

TEST(UpdateKernels, FindUnlikeIsTheFirstCellThatDiffers) {
  for (const std::int64_t target : testing::FusedTargets()) {
    const testing::WithTarget chosen(target);
    for (int count = 0; count <= 70; ++count) {
      std::vector<float> row(static_cast<std::size_t>(count) + 1, 2.0F);
      row.back() = 0.0F;  // Beyond the row.
      EXPECT_EQ(FindUnlike(row.data(), 2.0F, count), count);
      for (int at = count - 1; at >= 0; --at) {
        row[static_cast<std::size_t>(at)] = 1.0F;
        ASSERT_EQ(FindUnlike(row.data(), 2.0F, count), at) << hwy::TargetName(target) << " count " << count;
      }
    }
  }
}

TEST(UpdateKernels, TextureIsSummedOverSeenCellsAndTheSameBytesOnEveryTarget) {
  constexpr float kSeenMin = 0.75F;
  for (int count = 0; count <= 70; ++count) {
    const Image<float> rows = RandomImage(count + 1, 2, 5);
    Image<float> seen = RandomImage(count + 1, 1, 6);
    for (float& n : seen.pixels()) n += 1.0F;
    TextureSums expected;
    for (int x = 0; x < count; ++x) {
      if (seen.at(x, 0) < kSeenMin) continue;
      const double across = rows.at(x + 1, 0) - rows.at(x, 0);
      const double down = rows.at(x, 1) - rows.at(x, 0);
      expected.size += std::abs(across) + std::abs(down);
      expected.squares += across * across + down * down;
      expected.seen += seen.at(x, 0);
      expected.count += 1.0;
    }
    TextureSums first;
    for (const std::int64_t target : testing::FusedTargets()) {
      const testing::WithTarget chosen(target);
      const TextureSums sums = SumTexture(rows.row(0), rows.row(1), seen.row(0), kSeenMin, count);
      EXPECT_NEAR(sums.size, expected.size, 1e-5 * (1.0 + expected.size));
      EXPECT_NEAR(sums.squares, expected.squares, 1e-5 * (1.0 + expected.squares));
      EXPECT_NEAR(sums.seen, expected.seen, 1e-5 * (1.0 + expected.seen));
      EXPECT_EQ(sums.count, expected.count);
      if (target == testing::FusedTargets().front()) first = sums;
      EXPECT_EQ(std::memcmp(&sums, &first, sizeof sums), 0) << hwy::TargetName(target) << " count " << count;
    }
  }
}

}  // namespace
}  // namespace trem
