// Goal: HINTS registers on its own, and captures what Gauss-Newton cannot reach. Method: frames that are samples of the prediction plus
// noise, at known views.
#include "worker/registration/hints_registration.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>

#include "tests/unit/worker/registration/synthetic_scene.h"

namespace trem {
namespace {

using testing::Corners;
using testing::SyntheticScene;

TEST(HintsRegistration, TheMeanOfTheDrawsIsNearTheTruth) {
  const SyntheticScene scene(81);
  Rng rng({7});
  for (std::uint64_t k = 0; k < 4; ++k) {
    const View truth = scene.NominalMovedBy(testing::RandomCorners(&rng, 0.3), 1.02, -2.0);
    const Image<float> frame = scene.Frame(truth, k);
    const std::uint64_t stream[3] = {1, 2, k};
    const ViewPrior prior = scene.PriorAbout(scene.Nominal(), 2.0);
    const Registration found = RegisterHints(scene.Observe(frame), scene.reference(), prior, HintsUse::kFull, stream);
    EXPECT_LT(LargestCornerMotion(found.view.scene_from_sensor, truth.scene_from_sensor, scene.roi), 0.1) << "case " << k;
    EXPECT_GT(found.corner_covariance.trace(), 0.0);
    const Registration again = RegisterHints(scene.Observe(frame), scene.reference(), prior, HintsUse::kFull, stream);
    EXPECT_EQ(found.view.scene_from_sensor.linear, again.view.scene_from_sensor.linear) << "the same stream gives the same draws";
  }
}

TEST(HintsRegistration, CaptureBringsTwelvePixelsWithinReachOfGaussNewton) {
  const SyntheticScene scene(101);
  for (std::uint64_t k = 0; k < 4; ++k) {
    const double x = k % 2 == 0 ? 8.5 : -8.5;
    const double y = k < 2 ? 8.5 : -8.5;
    const View truth = scene.NominalMovedBy(Corners(x, y, x, y, x, y));
    const Image<float> frame = scene.Frame(truth, k);
    const std::uint64_t stream[3] = {5, 6, k};
    const ViewPrior prior = scene.PriorAbout(scene.Nominal(), 20.0);
    const Registration captured = RegisterHints(scene.Observe(frame), scene.reference(), prior, HintsUse::kCapture, stream);
    const Registration found = RegisterGaussNewton(scene.Observe(frame), scene.reference(), prior, captured.view, {});
    EXPECT_LT(LargestCornerMotion(found.view.scene_from_sensor, truth.scene_from_sensor, scene.roi), 0.03) << "case " << k;
  }
}

TEST(HintsRegistration, CaptureBringsTwentyPixelsAndTwelveDegreesWithinReachOfGaussNewton) {
  const SyntheticScene scene(121, 2);
  const double angle = 12.0 * 3.14159265358979323846 / 180.0;
  Eigen::Matrix2d turn;
  turn << std::cos(angle) - 1.0, -std::sin(angle), std::sin(angle), std::cos(angle) - 1.0;
  const Eigen::Vector2d shift(12.0, -16.0);
  CornerVector d(6);
  d << turn * Eigen::Vector2d(-60.0, -60.0) + shift, turn * Eigen::Vector2d(60.0, -60.0) + shift, turn * Eigen::Vector2d(-60.0, 60.0) + shift;
  const Image<float> frame = scene.Frame(scene.Nominal(), 1);
  const View start = scene.NominalMovedBy(d);
  const ViewPrior prior = scene.PriorAbout(start, 20.0);
  const std::uint64_t stream[3] = {5, 6, 7};
  const Registration captured = RegisterHints(scene.Observe(frame), scene.reference(), prior, HintsUse::kCapture, stream);
  const Registration found = RegisterGaussNewton(scene.Observe(frame), scene.reference(), prior, captured.view, {});
  EXPECT_LT(LargestCornerMotion(found.view.scene_from_sensor, scene.Nominal().scene_from_sensor, scene.roi), 0.05);
  const Registration alone = RegisterGaussNewton(scene.Observe(frame), scene.reference(), prior, start, {});
  EXPECT_GT(LargestCornerMotion(alone.view.scene_from_sensor, scene.Nominal().scene_from_sensor, scene.roi), 1.0) << "control";
}

// The ellipsoid that should hold the truth in 95 of 100 frames (chi-square with six degrees of freedom: 12.592). Over 200 frames the count
// has a standard deviation of 1.5 %: 90 .. 98 % are its limits of 3.3 and 2 of them; the seeds are fixed.
void ExpectNominalCoverage(GainOffset gain_offset) {
  constexpr int kCount = 200;
  const SyntheticScene scene(61, 3);
  Rng rng({8});
  HintsSettings settings;
  settings.gain_offset = gain_offset;
  int covered = 0;
  double effective = 0.0;
  for (std::uint64_t k = 0; k < kCount; ++k) {
    const View truth = scene.NominalMovedBy(testing::RandomCorners(&rng, 0.5), 1.0 + 0.05 * rng.Normal(), 4.0 * rng.Normal());
    const Image<float> frame = scene.Frame(truth, 1000 + k);
    const std::uint64_t stream[3] = {1, 2, k};
    HintsCost cost;
    const Registration found = RegisterHints(scene.Observe(frame), scene.reference(), scene.PriorAbout(scene.Nominal(), 3.0),
                                             HintsUse::kFull, stream, settings, &cost);
    const CornerVector d = CornerDisplacement(found.view.scene_from_sensor, truth.scene_from_sensor, scene.roi);
    covered += d.dot(found.corner_covariance.ldlt().solve(d)) < 12.592 ? 1 : 0;
    effective += cost.effective_draws / kCount;
  }
  EXPECT_GE(covered, 180);
  EXPECT_LE(covered, 196);
  EXPECT_GT(effective, 15.0) << "of 48 draws";
}

TEST(HintsRegistration, TheCovarianceOfTheDrawsCoversTheTrueErrorAtItsRate) { ExpectNominalCoverage(GainOffset::kMaximumLikelihood); }

TEST(HintsRegistration, WithGainAndOffsetIntegratedOutItCoversAsWell) { ExpectNominalCoverage(GainOffset::kMarginalised); }

TEST(HintsRegistration, ProjectiveViewsHaveEightParameters) {
  const SyntheticScene scene(101);
  CornerVector d(8);
  d << 0.6, -0.3, -0.5, 0.2, 0.4, 0.7, 1.4, -0.8;
  const View truth = scene.NominalMovedBy(d, 1.02, -2.0);
  const Image<float> frame = scene.Frame(truth, 1);
  const std::uint64_t stream[3] = {1, 2, 3};
  ViewPrior prior = scene.PriorAbout(scene.Nominal(), 3.0);
  const Registration affine = RegisterHints(scene.Observe(frame), scene.reference(), prior, HintsUse::kFull, stream);
  EXPECT_GT(LargestCornerMotion(affine.view.scene_from_sensor, truth.scene_from_sensor, scene.roi), 0.1) << "control";
  prior.information = CornerMatrix::Identity(8, 8) / 9.0;
  const Registration found = RegisterHints(scene.Observe(frame), scene.reference(), prior, HintsUse::kFull, stream);
  EXPECT_LT(LargestCornerMotion(found.view.scene_from_sensor, truth.scene_from_sensor, scene.roi), 0.05);
  EXPECT_EQ(found.corner_covariance.rows(), 8);
  const Registration captured = RegisterHints(scene.Observe(frame), scene.reference(), prior, HintsUse::kCapture, stream);
  EXPECT_LT(LargestCornerMotion(captured.view.scene_from_sensor, truth.scene_from_sensor, scene.roi), 2.0);
}

TEST(HintsRegistration, WeightsOfZeroAndDeadPixelsDoNotBendIt) {
  const SyntheticScene scene(81);
  const View truth = scene.NominalMovedBy(Corners(0.4, -0.3, 0.5, 0.1, -0.2, 0.3));
  Image<float> frame = scene.Frame(truth, 1);
  Image<float> weights(81, 81, 1.0F);
  for (int v = 0; v < 81; ++v) {
    for (int u = 60; u < 81; ++u) {
      weights.at(u, v) = 0.0F;
      frame.at(u, v) = 255.0F;
    }
  }
  Rng rng({3});
  for (int k = 0; k < 30; ++k) frame.at(static_cast<int>(rng.UniformIndex(60)), static_cast<int>(rng.UniformIndex(81))) = 255.0F;
  Observation observation = scene.Observe(frame);
  observation.weights = &weights;
  const std::uint64_t stream[3] = {1, 2, 3};
  for (const GainOffset gain_offset : {GainOffset::kMaximumLikelihood, GainOffset::kMarginalised}) {
    HintsSettings settings;
    settings.gain_offset = gain_offset;
    const Registration found =
        RegisterHints(observation, scene.reference(), scene.PriorAbout(scene.Nominal(), 2.0), HintsUse::kFull, stream, settings);
    EXPECT_LT(LargestCornerMotion(found.view.scene_from_sensor, truth.scene_from_sensor, scene.roi), 0.06);
  }
}

}  // namespace
}  // namespace trem
