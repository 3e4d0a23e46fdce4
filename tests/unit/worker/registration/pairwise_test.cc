// Goal: the pairwise search finds maxima and views, in four dimensions and in all, and uses nothing that it must not use. Method: a
// quadratic with a known maximum; frames that are samples of the prediction plus noise, at known views.
#include "worker/registration/pairwise.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/unit/worker/registration/synthetic_scene.h"

namespace trem {
namespace {

using testing::Corners;
using testing::SyntheticScene;

double ErrorPx(const Registration& registration, const View& truth, const Roi& roi) {
  return LargestCornerMotion(registration.view.scene_from_sensor, truth.scene_from_sensor, roi);
}

TEST(SearchPairs, FindsTheMaximumOfACorrelatedQuadraticToItsLastStep) {
  HintsState maximum(3);
  maximum << 1.3, -0.7, 2.1;
  HintsMatrix information(3, 3);
  information << 4.0, 1.5, 0.3, 1.5, 2.0, -0.4, 0.3, -0.4, 1.0;
  const auto log_density = [&](const HintsState& x) -> double { return -(x - maximum).dot(information * (x - maximum)); };
  PairwiseOptions options;
  options.last_step_px = 1.0 / 256.0;
  int scales = 0;
  const PairwiseResult found = SearchPairs(log_density, HintsState::Zero(3), 1.0, options, [&](const HintsState&) { ++scales; });
  EXPECT_LT((found.state - maximum).cwiseAbs().maxCoeff(), 2.0 / 256.0);
  EXPECT_EQ(found.log_density, log_density(found.state));
  EXPECT_EQ(scales, 9) << "1, 1/2 ... 1/256";
}

TEST(SearchPairs, NeverMovesToAStateThatIsNotFinite) {
  const auto log_density = [](const HintsState& x) { return x(0) > 0.4 ? std::nan("") : x(0) - x(1) * x(1); };
  const PairwiseResult found = SearchPairs(log_density, HintsState::Zero(2), 1.0, {}, nullptr);
  EXPECT_LE(found.state(0), 0.4);
  EXPECT_GT(found.state(0), 0.35);
}

TEST(Pairwise, RegistersInFourDimensionsAndInAll) {
  const SyntheticScene scene(81);
  const ViewPrior prior = scene.PriorAbout(scene.Nominal(), 2.0);
  HintsState similar(4);
  similar << 0.8, -0.5, 0.6, 0.3;
  const ViewChart four = SimilarityChart(prior, scene.roi);
  const View turned = {four.At(similar).scene_from_sensor, 1.03, -4.0};
  const Image<float> turned_frame = scene.Frame(turned, 1);
  std::int64_t evaluations = 0;
  const Registration in_four = RegisterPairwise(scene.Observe(turned_frame), scene.reference(), prior, four, {}, &evaluations);
  EXPECT_LT(ErrorPx(in_four, turned, scene.roi), 0.06);
  EXPECT_NEAR(in_four.view.gain, 1.03, 0.005);
  EXPECT_NEAR(in_four.view.offset, -4.0, 0.6);
  EXPECT_EQ(evaluations % (81 * 81), 0);

  const View sheared = scene.NominalMovedBy(Corners(0.4, -0.3, 0.5, 0.1, -0.2, 0.3));
  const Image<float> frame = scene.Frame(sheared, 2);
  const Registration in_all =
      RegisterPairwise(scene.Observe(frame), scene.reference(), prior, FullChart(prior, scene.roi), PairwiseOptions{});
  EXPECT_LT(ErrorPx(in_all, sheared, scene.roi), 0.06);
  EXPECT_TRUE(in_all.converged);
}

TEST(Pairwise, HonoursWeightsSeenCellsAndDeadPixels) {
  SyntheticScene scene(81);
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
  for (int y = 0; y < scene.seen.height(); ++y) {
    for (int x = 0; x < 100; ++x) scene.seen.at(x, y) = 0.0F;
    for (int x = 0; x < 97; ++x) scene.prediction.at(x, y) = 1e6F;
  }
  Observation observation = scene.Observe(frame);
  observation.weights = &weights;
  const ViewPrior prior = scene.PriorAbout(scene.Nominal(), 2.0);
  const Registration found = RegisterPairwise(observation, scene.reference(), prior, FullChart(prior, scene.roi), {});
  EXPECT_LT(ErrorPx(found, truth, scene.roi), 0.15) << "from about half of the ROI";
}

TEST(Pairwise, OffTheSceneItDoesNotConverge) {
  const SyntheticScene scene(61);
  const Image<float> frame = scene.Frame(scene.Nominal(), 1);
  const ViewPrior prior = scene.PriorAbout(scene.NominalMovedBy(Corners(500, 0, 500, 0, 500, 0)), 1.0);
  const Registration found = RegisterPairwise(scene.Observe(frame), scene.reference(), prior, FullChart(prior, scene.roi), {});
  EXPECT_LT(found.overlap, 0.05);
  EXPECT_FALSE(found.converged);
}

}  // namespace
}  // namespace trem
