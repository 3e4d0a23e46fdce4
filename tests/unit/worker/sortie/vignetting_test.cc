// Goal: vignetting is found from frames that move over the ground, whatever the exposure does, and is not found where there is none or
// where nothing tells. Method: frames of a random ground under a known factor, moved by known shifts; no rendering of optics is needed,
// because patches of a twelfth of the image are compared.
#include "worker/sortie/vignetting.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "mosaic/base/rng.h"

namespace trem {
namespace {

constexpr int kWidth = 256;
constexpr int kHeight = 200;

struct Flight {
  int frames = 60;
  double shift_px = 5.0;  // Downwards a frame.
  double loss = 0.0;      // Of the light, in the corners.
  double gain_step = 0.0;
  double offset_drift = 0.0;  // Grey levels a frame.
  int cut_every = 0;
  std::function<void(int, Image<float>*)> add = nullptr;
};

// Smooth in patches, rough from pixel to pixel, and with a gradient that looks like a shade of its own.
double GroundAt(const Image<float>& noise, double x, double y) {
  const int i = static_cast<int>(x / 6.0), j = static_cast<int>(y / 6.0);
  return 90.0 + 25.0 * std::sin(0.013 * x + 0.021 * y) + 0.02 * y + noise.at(i % noise.width(), j % noise.height());
}

Image<float> NoiseOf(std::uint64_t seed) {
  Rng rng({seed, 3});
  Image<float> noise(97, 211);
  for (float& value : noise.pixels()) value = static_cast<float>(14.0 * rng.Normal());
  return noise;
}

std::optional<VignettingEstimate> Fly(const Flight& flight, double level_max = 250.0) {
  const Image<float> ground = NoiseOf(5);
  Rng rng({8, 4});
  VignettingFinder finder(kWidth, kHeight, {0, 0, kWidth, kHeight}, level_max);
  const double half_x = 0.5 * (kWidth - 1), half_y = 0.5 * (kHeight - 1);
  for (int t = 0; t < flight.frames; ++t) {
    const double gain = 1.0 - flight.gain_step * ((t / 7) % 3), offset = flight.offset_drift * t;
    Image<float> frame(kWidth, kHeight);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const double r2 = ((x - half_x) * (x - half_x) + (y - half_y) * (y - half_y)) / (half_x * half_x + half_y * half_y);
        const double light = gain * GroundAt(ground, x, y + flight.shift_px * t) + offset;
        frame.at(x, y) = static_cast<float>((1.0 - flight.loss * r2) * light + 2.0 * rng.Normal());
      }
    }
    if (flight.add) flight.add(t, &frame);
    Affine motion;
    motion.offset = {0.0, flight.shift_px};
    const bool cut = t == 0 || (flight.cut_every > 0 && t % flight.cut_every == 0);
    finder.Add(frame, cut ? std::nullopt : std::optional<Affine>(motion));
  }
  return finder.Find();
}

TEST(Vignetting, IsFoundWhateverTheExposureDoes) {
  for (const double loss : {0.08, 0.33, 0.6}) {
    const auto found = Fly({.loss = loss, .gain_step = 0.2, .offset_drift = 0.15});
    ASSERT_TRUE(found.has_value());
    EXPECT_TRUE(found->Seen()) << loss;
    for (const double r2 : {0.25, 0.5, 1.0}) {
      EXPECT_NEAR(found->vignetting.At(r2), 1.0 - loss * r2, loss < 0.5 ? 0.01 : 0.02) << loss << " at " << r2;
    }
    EXPECT_LT(found->corner_error, 0.02);
  }
}

TEST(Vignetting, IsNotFoundWhereThereIsNone) {
  for (const double gain_step : {0.0, 0.25}) {
    const auto found = Fly({.gain_step = gain_step, .offset_drift = 0.1});
    ASSERT_TRUE(found.has_value());
    EXPECT_FALSE(found->Seen()) << found->vignetting.Corner() << " +- " << found->corner_error;
    EXPECT_NEAR(found->vignetting.Corner(), 1.0, 0.015);
  }
}

TEST(Vignetting, NeedsGroundThatIsSeenAtDifferentPlaces) {
  EXPECT_FALSE(Fly({.shift_px = 0.0, .loss = 0.33}).has_value()) << "over a still scene it could be the ground";
  EXPECT_FALSE(Fly({.loss = 0.33, .cut_every = 1}).has_value());
  EXPECT_TRUE(Fly({.loss = 0.33, .cut_every = 20}).has_value());
}

TEST(Vignetting, MoversAndSaturatedRoofsDoNotBendIt) {
  // A bright box that stays at one place of the image, and a roof at one place of the ground that the sensor clips.
  const auto disturb = [](int t, Image<float>* frame) {
    for (int y = 20; y < 60; ++y) {
      for (int x = 20; x < 60; ++x) frame->at(x, y) = 220.0F;
    }
    for (int y = 300; y < 340; ++y) {
      const int row = y - 5 * t;
      for (int x = 100; x < 160 && row >= 0 && row < kHeight; ++x) frame->at(x, row) = 255.0F;
    }
  };
  const auto found = Fly({.loss = 0.33, .add = disturb});
  ASSERT_TRUE(found.has_value());
  EXPECT_NEAR(found->vignetting.Corner(), 0.67, 0.02);
}

TEST(Vignetting, MemoryIsBoundedOverLongSorties) {
  // More key frames than are kept: the estimate is as good.
  const auto found = Fly({.frames = 700, .shift_px = 17.0, .loss = 0.33});
  ASSERT_TRUE(found.has_value());
  EXPECT_LE(found->pair_count, 128u * 6u);
  EXPECT_NEAR(found->vignetting.Corner(), 0.67, 0.01);
}

TEST(Vignetting, IsUndoneInAWholeFrame) {
  v1::SensorManifest sensor;
  EXPECT_TRUE(BrighteningOf(sensor, 20, 10).empty());
  sensor.mutable_vignetting()->set_second(-0.3);
  sensor.mutable_vignetting()->set_fourth(-0.1);
  const Image<float> brightening = BrighteningOf(sensor, 21, 11);
  EXPECT_NEAR(brightening.at(10, 5), 1.0, 1e-6);
  EXPECT_NEAR(brightening.at(0, 0), std::exp(0.4), 1e-6);
  EXPECT_NEAR(brightening.at(20, 10), std::exp(0.4), 1e-6);
  Image<float> frame(21, 11, 100.0F);
  Brighten(brightening, &frame);
  EXPECT_NEAR(frame.at(0, 10), 100.0 * std::exp(0.4), 1e-3);
}

}  // namespace
}  // namespace trem
