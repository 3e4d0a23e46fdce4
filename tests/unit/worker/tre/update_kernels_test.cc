// Goal: what the scene update asks of a row is answered alike on every SIMD target, at every length. Method: plain loops over rows of
// random values; the sums of different targets must agree to the byte.
#include "worker/tre/update_kernels.h"

#include <gtest/gtest.h>

#include <algorithm>
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

TEST(UpdateKernels, ARowIsPredictedBilinearlyWhereTheSceneWasSeenAndTheSameOnEveryTarget) {
  constexpr int kWidth = 60;
  constexpr int kHeight = 40;
  constexpr int kCount = 45;
  const Image<float> prediction = RandomImage(kWidth, kHeight, 8);
  Image<float> seen = RandomImage(kWidth, kHeight, 9);
  for (float& n : seen.pixels()) n += 1.5F;
  for (const bool affine : {true, false}) {
    OverlaidRow row{prediction.row(0), seen.row(0), kWidth, kHeight, -95.0F, 205.0F, 0.9F, 1.7F, 0.4F, 0.004F,
                    -101.0F,           199.0F,      affine, 0.75F,   1.3F,   -4.0F};
    int used = 0;
    for (const std::int64_t target : testing::FusedTargets()) {
      const testing::WithTarget chosen(target);
      std::vector<float> predicted(kCount + 1, 77.0F);
      std::vector<float> frames(kCount + 1, 77.0F);
      PredictRow(row, kCount, predicted.data(), frames.data());
      EXPECT_EQ(predicted.back(), 77.0F);
      EXPECT_EQ(frames.back(), 77.0F);
      for (int u = 0; u < kCount; ++u) {
        const float i = static_cast<float>(u);
        const float scale = affine ? 1.0F : 1.0F / (row.depth + row.d_depth * i);
        const float x = (row.x + row.dx * i) * scale - row.left;
        const float y = (row.y + row.dy * i) * scale - row.top;
        float value = NAN;
        float n = 0.0F;
        if (x >= 0.0F && y >= 0.0F && x < kWidth - 1 && y < kHeight - 1) {
          const int ix = static_cast<int>(x);
          const int iy = static_cast<int>(y);
          const float tx = x - static_cast<float>(ix);
          const float ty = y - static_cast<float>(iy);
          const float near = seen.at(ix + (tx >= 0.5F ? 1 : 0), iy + (ty >= 0.5F ? 1 : 0));
          const float upper = prediction.at(ix, iy) + tx * (prediction.at(ix + 1, iy) - prediction.at(ix, iy));
          const float lower = prediction.at(ix, iy + 1) + tx * (prediction.at(ix + 1, iy + 1) - prediction.at(ix, iy + 1));
          if (near >= row.seen_min) {
            value = row.gain * (upper + ty * (lower - upper)) + row.offset;
            n = near;
            ++used;
          }
        }
        const auto at = static_cast<std::size_t>(u);
        ASSERT_EQ(std::isnan(predicted[at]), std::isnan(value)) << hwy::TargetName(target) << " " << u;
        if (!std::isnan(value)) ASSERT_EQ(predicted[at], value) << hwy::TargetName(target) << " " << u;
        ASSERT_EQ(frames[at], n) << hwy::TargetName(target) << " " << u;
      }
    }
    EXPECT_GT(used, 10);
  }
}

TEST(UpdateKernels, ResidualsAndWhatExplainsThemAreTheSameOnEveryTarget) {
  constexpr int kCount = 45;
  Image<float> predicted = RandomImage(kCount, 3, 11);
  predicted.at(7, 0) = predicted.at(7, 1) = predicted.at(7, 2) = predicted.at(20, 1) = NAN;
  Image<float> frames = RandomImage(kCount, 1, 12);
  for (float& n : frames.pixels()) n = std::abs(3.0F * n);
  const Image<float> pixels = RandomImage(kCount, 1, 13);
  Image<float> weights = RandomImage(kCount, 1, 14);
  for (float& w : weights.pixels()) w = std::max(w, 0.0F);
  const float* const rows[] = {predicted.row(0), predicted.row(1), predicted.row(2)};
  for (const std::int64_t target : testing::FusedTargets()) {
    const testing::WithTarget chosen(target);
    std::vector<float> low(kCount + 2 + kRowSlack);
    std::vector<float> high(low.size());
    RangeOfRows(rows, kCount, low.data() + 1, high.data() + 1);
    low[0] = low[kCount + 1] = 1e9F;
    high[0] = high[kCount + 1] = -1e9F;
    const ExplainedRow row{low.data() + 1, high.data() + 1, rows[1], frames.row(0), pixels.row(0), weights.row(0), 4.0F,
                           0.1F,           0.45F,           0.75F};
    std::vector<float> variance(kCount + 1, 77.0F);
    std::vector<float> residual(kCount + 1, 77.0F);
    ExplainRow(row, kCount, variance.data(), residual.data());
    EXPECT_EQ(variance.back(), 77.0F);
    EXPECT_EQ(residual.back(), 77.0F);
    for (int u = 0; u < kCount; ++u) {
      float least = 1e9F;
      float most = -1e9F;
      for (int j = 0; j < 9; ++j) {
        const int at = u + j % 3 - 1;
        if (at < 0 || at >= kCount || std::isnan(predicted.at(at, j / 3))) continue;
        least = std::min(least, predicted.at(at, j / 3));
        most = std::max(most, predicted.at(at, j / 3));
      }
      const float inverse_n = 1.0F / std::max(frames.at(u, 0), 0.75F);
      const float part = (0.1F + 0.45F * inverse_n) * std::max(most - least, 0.0F);
      const float weight = weights.at(u, 0);
      const auto index = static_cast<std::size_t>(u);
      ASSERT_EQ(variance[index], 4.0F * (1.0F / std::max(weight, 1e-3F) + inverse_n) + part * part) << hwy::TargetName(target) << " " << u;
      const float left = pixels.at(u, 0) - predicted.at(u, 1);
      ASSERT_EQ(std::isnan(residual[index]), !(weight > 0.0F) || std::isnan(left)) << hwy::TargetName(target) << " " << u;
      if (!std::isnan(residual[index])) ASSERT_EQ(residual[index], left) << hwy::TargetName(target) << " " << u;
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
