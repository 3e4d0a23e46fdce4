// Goal: every sample lands in its cell with the value and weight that the scene update's documentation states, on every SIMD target.
// Method: a scalar splat in double precision over views with rotation, zoom, perspective and reversed axes; outliers, NaN and weighted
// pixels; bands of rows that together must give what the whole gives.
#include "worker/tre/splat_kernel.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "tests/support/simd_targets.h"
#include "tests/unit/worker/sensor/random_image.h"
#include "worker/sensor/bicubic.h"

namespace trem {
namespace {

constexpr int kWidth = 90;
constexpr int kHeight = 80;
const SplatModel kModel{1.1F, -3.0F, 6.0F};

struct Scene {
  Image<float> prediction = RandomImage(kWidth, kHeight, 1);
  Image<float> seen = RandomImage(kWidth, kHeight, 2);
  Image<float> weight{kWidth, kHeight};
  Image<float> weighted{kWidth, kHeight};

  Scene() {
    for (float& p : prediction.pixels()) p = 100.0F + 5.0F * p;
    for (float& s : seen.pixels()) s = 1.5F + s;
  }
  SplatPlanes planes() { return {&prediction, &seen, &weight, &weighted}; }
};

struct Map {
  double x, y, dx, dy;    // Of the first row's first pixel, and along a row.
  double down_x, down_y;  // From row to row.
  double d_depth = 0.0, down_depth = 0.0;
};

// No sample lies on the border between two cells, where rounding decides.
const Map kMaps[] = {
    {3.2071, 4.1033, 3.0, 0.0, 0.0, 3.0},                              // Upright, as at a segment's beginning.
    {20.3137, 2.4219, 2.7031, 1.1007, -1.1013, 2.7039},                // Turned and enlarged.
    {86.4127, 75.2171, -3.0211, 0.3013, -0.2017, -2.9023},             // Reversed.
    {40.7119, -5.6113, 0.0411, 2.9017, 2.8019, 0.3029},                // On its side, and beginning outside.
    {5.2171, 6.4311, 3.9013, 0.6017, -0.4011, 3.7029, 0.021, 0.013},   // Oblique.
    {5.2171, 6.4311, 3.9013, 0.6017, -0.4011, 3.7029, -0.061, 0.002},  // With the horizon across it.
};

Image<float> Frame() {
  Image<float> frame = RandomImage(27, 25, 3);
  for (float& p : frame.pixels()) p = 107.0F + 9.0F * p;
  frame.at(5, 4) = frame.at(26, 24) = std::numeric_limits<float>::quiet_NaN();
  return frame;
}

Image<float> Weights() {
  Image<float> weights = RandomImage(27, 25, 4);
  for (float& w : weights.pixels()) w = std::max(w, 0.0F);
  weights.at(7, 7) = std::numeric_limits<float>::quiet_NaN();
  return weights;
}

// Rows of the scene in bands of `band_rows`.
Scene Splatted(const Map& map, const Image<float>* weights, int band_rows) {
  Scene scene;
  const Image<float> frame = Frame();
  for (int band = 0; band < kHeight; band += band_rows) {
    for (int v = 0; v < frame.height(); ++v) {
      SplatRow row;
      row.pixels = frame.row(v);
      row.weights = weights != nullptr ? weights->row(v) : nullptr;
      row.end = frame.width();
      row.x = map.x + v * map.down_x;
      row.y = map.y + v * map.down_y;
      row.dx = map.dx;
      row.dy = map.dy;
      row.depth = 1.0 + v * map.down_depth;
      row.d_depth = map.d_depth;
      Splat(row, kModel, band, std::min(band + band_rows, kHeight), scene.planes());
    }
  }
  return scene;
}

struct Sums {
  Image<double> weight{kWidth, kHeight};
  Image<double> weighted{kWidth, kHeight};
  int outliers = 0;
};

Sums PlainSplat(const Map& map, const Image<float>* weights) {
  Sums sums;
  const Scene scene;
  const Image<float> frame = Frame();
  for (int v = 0; v < frame.height(); ++v) {
    for (int u = 0; u < frame.width(); ++u) {
      const double depth = 1.0 + u * map.d_depth + v * map.down_depth;
      if (depth <= 0.0) continue;
      const double x = (map.x + v * map.down_x + u * map.dx) / depth;
      const double y = (map.y + v * map.down_y + u * map.dy) / depth;
      const double trust = weights != nullptr ? weights->at(u, v) : 1.0;
      if (std::isnan(frame.at(u, v)) || !(trust > 0.0) || !CubicSupported(scene.prediction, x, y)) continue;
      const int cx = static_cast<int>(x + 0.5);
      const int cy = static_cast<int>(y + 0.5);
      const double value = (static_cast<double>(frame.at(u, v)) - static_cast<double>(kModel.offset)) / static_cast<double>(kModel.gain);
      const double predicted = SampleCubic(scene.prediction, x, y);
      const double size = std::abs(static_cast<double>(kModel.gain) * (value - predicted));
      const bool outlier = scene.seen.at(cx, cy) >= 1.5F && size > static_cast<double>(kModel.limit);
      sums.outliers += outlier ? 1 : 0;
      const double weight =
          trust * (outlier ? static_cast<double>(kModel.limit) / size : 1.0) * std::pow(static_cast<double>(kModel.gain), 2);
      sums.weight.at(cx, cy) += weight;
      sums.weighted.at(cx, cy) += weight * (value - predicted + static_cast<double>(scene.prediction.at(cx, cy)));
    }
  }
  return sums;
}

TEST(Splat, EqualsAScalarSplatWithinRoundingOnEveryTarget) {
  const Image<float> weights = Weights();
  for (const std::int64_t target : testing::FusedTargets()) {
    const testing::WithTarget chosen(target);
    for (const Map& map : kMaps) {
      for (const Image<float>* w : {static_cast<const Image<float>*>(nullptr), &weights}) {
        const Sums expected = PlainSplat(map, w);
        ASSERT_GT(expected.outliers, 10) << "the case tests something";
        const Scene scene = Splatted(map, w, kHeight);
        for (int y = 0; y < kHeight; ++y) {
          for (int x = 0; x < kWidth; ++x) {
            ASSERT_NEAR(scene.weight.at(x, y), expected.weight.at(x, y), 1e-4) << x << ", " << y;
            ASSERT_NEAR(scene.weighted.at(x, y), expected.weighted.at(x, y), 1e-2) << x << ", " << y;
          }
        }
      }
    }
  }
}

TEST(Splat, BandsOfRowsAndTargetsGiveTheSameBytes) {
  const Image<float> weights = Weights();
  for (const Map& map : kMaps) {
    const Scene whole = Splatted(map, &weights, kHeight);
    for (const std::int64_t target : testing::FusedTargets()) {
      const testing::WithTarget chosen(target);
      for (const int band_rows : {1, 7, kHeight}) {
        const Scene banded = Splatted(map, &weights, band_rows);
        for (int y = 0; y < kHeight; ++y) {
          for (int x = 0; x < kWidth; ++x) {
            ASSERT_EQ(banded.weight.at(x, y), whole.weight.at(x, y)) << hwy::TargetName(target) << " bands of " << band_rows;
            ASSERT_EQ(banded.weighted.at(x, y), whole.weighted.at(x, y)) << hwy::TargetName(target) << " bands of " << band_rows;
          }
        }
      }
    }
  }
}

}  // namespace
}  // namespace trem
