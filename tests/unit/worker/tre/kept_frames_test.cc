// Goal: what KeptFrames accumulates is the data term about the present prediction, exactly; nothing is lost by holding frames out, by the
// memory's bound or by threads; and the weight that frames held out ask for does not depend on where the search starts.
// Method: a dense sum in double precision over turned and enlarged views with forgetting; random predictions; a rendered sequence for the
// weight.
#include "worker/tre/kept_frames.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "tests/support/rendered_sequence.h"
#include "tests/unit/worker/sensor/random_image.h"
#include "worker/sensor/bicubic.h"
#include "worker/tre/held_out_weight.h"

namespace trem {
namespace {

constexpr int kRatio = 3;
const Roi kRoi{0, 0, 24, 22};
const Roi kPlane{-6, -6, 80, 74};
constexpr double kNoHuber = 1e9;

View ViewOf(int t) {
  View view;
  const double angle = 0.02 * t;
  view.scene_from_sensor.linear << kRatio * std::cos(angle), -kRatio * std::sin(angle), kRatio * std::sin(angle), kRatio * std::cos(angle);
  view.scene_from_sensor.offset = Eigen::Vector2d(1.0 + 0.37 * t, 2.0 - 0.29 * t);
  view.gain = 1.0 + 0.05 * t;
  view.offset = 3.0 * t;
  return view;
}

KeptFrame FrameOf(int t) {
  KeptFrame frame{t, kRoi, 2.0, RandomImage(kRoi.width(), kRoi.height(), 10 + static_cast<std::uint64_t>(t)), {}, ViewOf(t)};
  for (float& p : frame.pixels.pixels()) p = 100.0F + 10.0F * p;
  frame.pixels.at(3, 4) = std::numeric_limits<float>::quiet_NaN();
  if (t == 1) {
    frame.weights = Image<float>(kRoi.width(), kRoi.height(), 0.5F);
    frame.weights.at(7, 7) = 0.0F;
  }
  return frame;
}

SceneBuffer BufferOf(std::uint64_t seed) {
  SceneBuffer buffer(kPlane);
  buffer.prediction = RandomImage(kPlane.width(), kPlane.height(), seed);
  for (float& p : buffer.prediction.pixels()) p = 100.0F + 5.0F * p;
  return buffer;
}

// C' w r of all frames, frame t faded by forgetting^(frames after it), every frame weighing 1.
Image<double> Pull(const SceneBuffer& buffer, int count, double forgetting) {
  Image<double> pull(kPlane.width(), kPlane.height());
  for (int t = 0; t < count; ++t) {
    const KeptFrame frame = FrameOf(t);
    const double faded = std::pow(forgetting, count - 1 - t);
    for (int v = 0; v < kRoi.height(); ++v) {
      for (int u = 0; u < kRoi.width(); ++u) {
        const double trust = frame.weights.empty() ? 1.0 : frame.weights.at(u, v);
        if (std::isnan(frame.pixels.at(u, v)) || trust == 0.0) continue;
        const Eigen::Vector2d cell = frame.view.scene_from_sensor * Eigen::Vector2d(u, v) - Eigen::Vector2d(kPlane.x0, kPlane.y0);
        if (!CubicSupported(buffer.prediction, cell.x(), cell.y())) continue;
        const double predicted = SampleCubic(buffer.prediction, cell.x(), cell.y());
        const double difference = (frame.pixels.at(u, v) - frame.view.offset) / frame.view.gain - predicted;
        const double value = faded * trust * frame.view.gain * frame.view.gain * difference;
        const int ix = static_cast<int>(cell.x());
        const int iy = static_cast<int>(cell.y());
        const auto wx = CubicWeights(static_cast<float>(cell.x() - ix));
        const auto wy = CubicWeights(static_cast<float>(cell.y() - iy));
        for (std::size_t j = 0; j < 4; ++j) {
          for (std::size_t i = 0; i < 4; ++i) pull.at(ix - 1 + static_cast<int>(i), iy - 1 + static_cast<int>(j)) += value * wx[i] * wy[j];
        }
      }
    }
  }
  return pull;
}

KeptFrames Filled(int count, double forgetting, const SceneBuffer& buffer, int threads = 1, std::size_t bytes_max = KeptFrames::kBytesMax) {
  KeptFrames kept(kNoHuber, threads, bytes_max);
  for (int t = 0; t < count; ++t) kept.Add(FrameOf(t), kPlane, forgetting, buffer);
  return kept;
}

TEST(KeptFrames, TheSlopeAtThePresentSceneIsTheDataTermsOwn) {
  constexpr double kForgetting = 0.9;
  const SceneBuffer buffer = BufferOf(1);
  const Accumulated sums = Filled(5, kForgetting, buffer).Accumulate(buffer, 0);
  const Image<double> expected = Pull(buffer, 5, kForgetting);
  for (std::size_t k = 0; k < expected.pixels().size(); ++k) {
    const float pull = sums.weighted.pixels()[k] - sums.weight.pixels()[k] * buffer.prediction.pixels()[k];
    ASSERT_NEAR(pull, expected.pixels()[k], 0.02) << k;
  }
}

TEST(KeptFrames, WhatIsHeldOutAndTheRestAreAll) {
  const SceneBuffer buffer = BufferOf(2);
  const KeptFrames kept = Filled(7, 0.95, buffer);
  const Accumulated all = kept.Accumulate(buffer, 0);
  const Accumulated parts = kept.Accumulate(buffer, 3);
  EXPECT_EQ(parts.held, (std::vector<std::size_t>{1, 4}));
  for (std::size_t k = 0; k < all.weight.pixels().size(); ++k) {
    ASSERT_NEAR(all.weight.pixels()[k], parts.weight.pixels()[k] + parts.held_weight.pixels()[k], 1e-4);
    ASSERT_NEAR(all.weighted.pixels()[k], parts.weighted.pixels()[k] + parts.held_weighted.pixels()[k], 0.05);
  }
}

TEST(KeptFrames, ThreadsDoNotMatter) {
  const SceneBuffer buffer = BufferOf(3);
  const Accumulated one = Filled(4, 0.95, buffer, 1).Accumulate(buffer, 2);
  const Accumulated three = Filled(4, 0.95, buffer, 3).Accumulate(buffer, 2);
  EXPECT_TRUE(std::equal(one.weighted.pixels().begin(), one.weighted.pixels().end(), three.weighted.pixels().begin()));
  EXPECT_TRUE(std::equal(one.held_weight.pixels().begin(), one.held_weight.pixels().end(), three.held_weight.pixels().begin()));
}

TEST(KeptFrames, TheOldestFramesBeyondTheBoundAreAddedUpForGood) {
  const SceneBuffer buffer = BufferOf(4);
  const std::size_t frame_bytes = 4 * static_cast<std::size_t>(kRoi.area());
  const KeptFrames bounded = Filled(9, 0.95, buffer, 1, 5 * frame_bytes);
  EXPECT_LE(bounded.size(), 5U);
  const Accumulated expected = Filled(9, 0.95, buffer).Accumulate(buffer, 0);
  const Accumulated sums = bounded.Accumulate(buffer, 0);
  // Each part weighs its frames by their own spreads beside each other's.
  double worst = 0.0;
  double sum = 0.0;
  for (std::size_t k = 0; k < sums.weight.pixels().size(); ++k) {
    worst = std::max(worst, std::abs(static_cast<double>(sums.weight.pixels()[k] - expected.weight.pixels()[k])));
    sum += expected.weight.pixels()[k];
  }
  EXPECT_GT(sum, 100.0);
  EXPECT_LT(worst, 0.4);
}

TEST(KeptFrames, ForgottenGroundHoldsNothingAndTheRestIsAsBefore) {
  SceneBuffer buffer = BufferOf(5);
  KeptFrames kept = Filled(4, 1.0, buffer);
  const Accumulated before = kept.Accumulate(buffer, 0);
  const Roi ground{20, 20, 29, 32};
  kept.Forget(ground);
  const Accumulated after = kept.Accumulate(buffer, 0);
  const Roi cells = buffer.InBuffer(ground);
  for (int y = 0; y < kPlane.height(); ++y) {
    for (int x = 0; x < kPlane.width(); ++x) {
      ASSERT_EQ(after.weight.at(x, y), cells.Contains(x, y) ? 0.0F : before.weight.at(x, y)) << x << ", " << y;
    }
  }
}

TEST(KeptFrames, ANoisyFrameWeighsLess) {
  SceneBuffer buffer = BufferOf(6);
  std::fill(buffer.prediction.pixels().begin(), buffer.prediction.pixels().end(), 100.0F);
  std::fill(buffer.seen.pixels().begin(), buffer.seen.pixels().end(), 5.0F);
  KeptFrames kept(kNoHuber, 1);
  for (int t = 0; t < 5; ++t) {
    KeptFrame frame{t, kRoi, 2.0, RandomImage(kRoi.width(), kRoi.height(), 30 + static_cast<std::uint64_t>(t)), {}, ViewOf(0)};
    for (float& p : frame.pixels.pixels()) p = 100.0F + (t == 3 ? 3.0F : 2.0F) * p;
    kept.Add(std::move(frame), kPlane, 1.0, buffer);
  }
  const Accumulated parts = kept.Accumulate(buffer, 7);  // Frame 3 is held out.
  ASSERT_EQ(parts.held, (std::vector<std::size_t>{3}));
  double noisy = 0.0;
  double others = 0.0;
  for (const float w : parts.held_weight.pixels()) noisy += w;
  for (const float w : parts.weight.pixels()) others += w / 4.0;
  EXPECT_NEAR(noisy / others, 4.0 / 9.0, 0.12);
}

// The weight that the frames held out ask for: found from three times too much and from three times too little, which the search's own
// prior about its start, a factor of two, must not stand in the way of.
TEST(HeldOutWeight, DoesNotDependOnWhereTheSearchStarts) {
  testing::SequenceOptions options;
  options.motion = testing::CameraMotion::kDwell;
  options.frame_count = 24;
  options.roi_px = 61;
  options.speed_px = 0.04;
  const testing::RenderedSequence sequence = testing::RenderSequence(options);
  const SeparablePsf psf = *MakePsf({options.psf_sigma_px, options.fill_factor}, kRatio);
  SceneBuffer buffer({-8, -8, 3 * 61 + 8, 3 * 61 + 8});
  InformationUpdate update(Blur(psf), {});
  KeptFrames kept(3.0, 1);
  for (int t = 0; t < options.frame_count; ++t) {
    const auto index = static_cast<std::size_t>(t);
    const View view{sequence.TruthFromScene(0).Inverse() * sequence.truth_from_sensor[index], sequence.gains[index],
                    sequence.offsets[index]};
    kept.Add({t, sequence.roi, 2.0, sequence.frames[index].pixels, {}, view}, buffer.extent, 1.0, buffer);
  }
  std::fill(buffer.scene.pixels().begin(), buffer.scene.pixels().end(), 110.0F);
  for (int round = 0; round < 3; ++round) {
    update.Predict(buffer.extent, &buffer);
    Accumulated sums = kept.Accumulate(buffer, 0);
    buffer.weight = sums.weight;
    buffer.weighted = sums.weighted;
    update.UpdateSeen(buffer.extent, kRatio, &buffer);
    update.Converge(buffer.extent, 80, 0.01F, &buffer);
  }
  const Accumulated sums = kept.Accumulate(buffer, 5);
  std::vector<double> found;
  for (const double start : {0.018, 0.054, 0.162}) {
    update.set_prior({StructurePriorKind::kHuberTv, 5.0F});
    const HeldOutWeight weight = FindHeldOutWeight(kept, sums, {static_cast<float>(start), 5.0F}, kRatio, 2.0, buffer, &update);
    found.push_back(std::log(start) + weight.log_factor);
    EXPECT_LE(weight.solutions, 6);
  }
  EXPECT_NEAR(found[0], found[1], 0.4);
  EXPECT_NEAR(found[2], found[1], 0.4);
}

}  // namespace
}  // namespace trem
