// Goal: HINTS registers on its own, and captures what Gauss-Newton cannot reach. Method: frames that are samples of the prediction plus
// noise, at known views.
#include "worker/registration/hints_registration.h"

#include <gtest/gtest.h>

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

}  // namespace
}  // namespace trem
