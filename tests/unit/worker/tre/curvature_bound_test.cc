// Goal: a scene whose cells are not counted with every frame still takes safe steps, because the bound on what a frame adds to the
// majoriser holds, and is not so large that the steps become short. Method: frames of random views (scale, turn, shear, shift) and gains
// are splatted into an empty buffer and the majoriser that they make is compared with the bound, for several PSFs and ratios; cells by the
// border, where the PSF is reflected, included. Then the majoriser of a scene that was counted once with the slack of later frames, against
// a fresh count.
#include "worker/tre/curvature_bound.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include "tests/unit/worker/sensor/random_image.h"
#include "worker/tre/information_update.h"

namespace trem {
namespace {

constexpr double kNoise = 2.0;

View RandomView(int ratio, std::mt19937* random) {
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  const double turn = 0.5 * unit(*random);
  const double scale = ratio * std::exp(0.25 * unit(*random));
  View view;
  Eigen::Matrix2d shear = Eigen::Matrix2d::Identity();
  shear(0, 1) = 0.1 * unit(*random);
  view.scene_from_sensor.linear << std::cos(turn), -std::sin(turn), std::sin(turn), std::cos(turn);
  view.scene_from_sensor.linear = scale * view.scene_from_sensor.linear * shear;
  view.scene_from_sensor.offset << 3.0 * unit(*random), 3.0 * unit(*random);
  view.gain = 1.0 + 0.3 * unit(*random);
  return view;
}

float MostOf(const Image<float>& image) { return *std::max_element(image.pixels().begin(), image.pixels().end()); }

TEST(CurvatureBound, NoFrameAddsMoreAndNotMuchLess) {
  std::mt19937 random(7);
  for (const int ratio : {2, 3, 4}) {
    for (const double sigma : {0.35, 0.6, 1.0}) {
      const SeparablePsf psf = *MakePsf({sigma, 0.9}, ratio);
      double tightest = std::numeric_limits<double>::infinity();
      for (int trial = 0; trial < 40; ++trial) {
        const Roi roi{0, 0, 31, 27};
        View view = RandomView(ratio, &random);
        // Of the nominal view the steps are whole cells: the samples are as regular as they can be.
        if (trial == 0) view.scene_from_sensor.linear = ratio * Eigen::Matrix2d::Identity();
        // Every third frame lies across the buffer's corner.
        const Roi extent = trial % 3 == 2 ? Roi{20, 20, 120, 120} : Roi{-150, -150, 300, 300};
        SceneBuffer buffer(extent);
        InformationUpdate update(Blur(psf), {});
        const Image<float> pixels = RandomImage(roi.width(), roi.height(), trial);
        const Observation observation{&pixels, roi, kNoise};
        update.AddFrame(observation, view, extent, &buffer);
        const float bound = CurvatureBound(psf).Of(observation, view, extent);
        ASSERT_EQ(buffer.counted.slack, bound);
        update.UpdateSeen(extent, ratio, &buffer);
        ASSERT_EQ(buffer.counted.slack, 0.0F);
        const float most = MostOf(buffer.majoriser);
        EXPECT_LE(most, bound) << "ratio " << ratio << ", sigma " << sigma << ", trial " << trial;
        if (trial % 3 != 2) tightest = std::min(tightest, static_cast<double>(bound / most));
      }
      // Where the samples of a frame stand out one by one (a PSF much narrower than their distance), the bound is their peak's.
      EXPECT_LT(tightest, 2.0) << "ratio " << ratio << ", sigma " << sigma;
    }
  }
}

TEST(CurvatureBound, WeightsCountAndWhatHasNoBoundSaysSo) {
  const SeparablePsf psf = *MakePsf({0.6, 0.9}, 3);
  const Roi extent{-150, -150, 300, 300};
  const Image<float> pixels = RandomImage(31, 27, 1);
  Image<float> weights(31, 27, 0.5F);
  View view;
  view.scene_from_sensor.linear *= 3.0;
  Observation observation{&pixels, {0, 0, 31, 27}, kNoise};
  const CurvatureBound bound(psf);
  const float plain = bound.Of(observation, view, extent);
  observation.weights = &weights;
  EXPECT_FLOAT_EQ(bound.Of(observation, view, extent), 0.5F * plain);
  weights.at(3, 4) = 4.0F;
  EXPECT_FLOAT_EQ(bound.Of(observation, view, extent), 4.0F * plain);
  View tilted = view;
  tilted.scene_from_sensor.perspective << 1e-4, 0.0;
  EXPECT_TRUE(std::isinf(bound.Of(observation, tilted, extent)));
}

TEST(CurvatureBound, AnOldCountWithItsSlackIsAboveAFreshOne) {
  std::mt19937 random(3);
  const SeparablePsf psf = *MakePsf({0.6, 0.9}, 3);
  const Roi extent{-60, -60, 180, 180};
  SceneBuffer buffer(extent);
  InformationUpdate update(Blur(psf), {});
  for (int frame = 0; frame < 12; ++frame) {
    const Image<float> pixels = RandomImage(31, 27, frame);
    update.AddFrame({&pixels, {0, 0, 31, 27}, kNoise}, RandomView(3, &random), extent, &buffer);
    const bool counted = update.RefreshSeen(extent, 3, 4, &buffer);
    EXPECT_EQ(counted, frame % 4 == 0) << frame;
    SceneBuffer fresh = buffer;
    update.UpdateSeen(extent, 3, &fresh);
    for (std::size_t i = 0; i < fresh.majoriser.pixels().size(); ++i) {
      ASSERT_LE(fresh.majoriser.pixels()[i], buffer.majoriser.pixels()[i] + buffer.counted.slack) << frame;
    }
  }
  // Ground that has no count, and a buffer that has moved, are counted at once.
  EXPECT_TRUE(update.RefreshSeen(extent, 3, 1, &buffer));
  buffer.MoveTo({-64, -60, 180, 180});
  EXPECT_TRUE(update.RefreshSeen(extent, 3, 4, &buffer));
  EXPECT_FALSE(update.RefreshSeen(extent, 3, 4, &buffer));
  EXPECT_TRUE(update.RefreshSeen(buffer.extent, 3, 4, &buffer));
}

}  // namespace
}  // namespace trem
