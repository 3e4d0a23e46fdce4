// Goal: every method gives a registration that is believed when it should be, and a reason when it should not. Method: frames that belong
// to the scene, lie off it, are noise, move too far, or have an absurd gain.
#include "worker/registration/registration.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

#include "tests/unit/worker/registration/synthetic_scene.h"

namespace trem {
namespace {

using testing::Corners;
using ::testing::HasSubstr;
using testing::SyntheticScene;

RegistrationRequest RequestAbout(const SyntheticScene& scene, const View& mean, double sigma_px) {
  RegistrationRequest request;
  request.prior = scene.PriorAbout(mean, sigma_px);
  return request;
}

TEST(Registration, EveryMethodIsBelievedOnAFrameOfTheScene) {
  const SyntheticScene scene(81);
  const View truth = scene.NominalMovedBy(Corners(0.4, -0.3, 0.5, 0.1, -0.2, 0.3));
  const Image<float> frame = scene.Frame(truth, 1);
  for (const RegistrationMethod method : {RegistrationMethod::kAuto, RegistrationMethod::kGaussNewton, RegistrationMethod::kHints,
                                          RegistrationMethod::kHintsThenGaussNewton, RegistrationMethod::kPairwise}) {
    RegistrationRequest request = RequestAbout(scene, scene.Nominal(), 2.0);
    request.method = method;
    const JudgedRegistration judged = Register(scene.Observe(frame), scene.reference(), request);
    EXPECT_EQ(judged.doubt, "");
    EXPECT_LT(LargestCornerMotion(judged.registration.view.scene_from_sensor, truth.scene_from_sensor, scene.roi), 0.1);
  }
}

TEST(Registration, AFrameOffTheSceneHasNoOverlap) {
  const SyntheticScene scene(61);
  const Image<float> frame = scene.Frame(scene.Nominal(), 1);
  const View far = scene.NominalMovedBy(Corners(300, 0, 300, 0, 300, 0));
  EXPECT_THAT(Register(scene.Observe(frame), scene.reference(), RequestAbout(scene, far, 1.0)).doubt,
              HasSubstr("overlaps the scene by 0 %"));
}

TEST(Registration, AFrameThatHoldsNothingSaysWhat) {
  const SyntheticScene scene(61);
  const RegistrationRequest request = RequestAbout(scene, scene.Nominal(), 2.0);
  Image<float> frame(61, 61, std::numeric_limits<float>::quiet_NaN());
  EXPECT_THAT(Register(scene.Observe(frame), scene.reference(), request).doubt, HasSubstr("has 0 usable pixels of the ROI's 3721"));
  frame = Image<float>(61, 61, 97.0F);
  EXPECT_THAT(Register(scene.Observe(frame), scene.reference(), request).doubt, HasSubstr("all its usable pixels have one grey level"));
  frame.at(0, 0) = std::numeric_limits<float>::infinity();
  const JudgedRegistration judged = Register(scene.Observe(frame), scene.reference(), request);
  EXPECT_THAT(judged.doubt, HasSubstr("all its usable pixels have one grey level"));
  EXPECT_TRUE(judged.registration.view.scene_from_sensor.linear.allFinite());
}

TEST(Registration, ASingularPriorIsNamed) {
  const SyntheticScene scene(61);
  const Image<float> frame = scene.Frame(scene.Nominal(), 1);
  // The ROI shrunk to a fifth of its side: an area of 1 / 25.
  const View small = scene.NominalMovedBy(Corners(24, 24, -24, 24, 24, -24));
  RegistrationRequest request = RequestAbout(scene, small, 0.01);
  request.method = RegistrationMethod::kGaussNewton;
  EXPECT_THAT(Register(scene.Observe(frame), scene.reference(), request).doubt, HasSubstr("singular view"));
}

TEST(Registration, NoiseDoesNotMatch) {
  const SyntheticScene scene(61);
  Rng rng({1});
  Image<float> noise(61, 61);
  for (float& pixel : noise.pixels()) pixel = static_cast<float>(110.0 + 40.0 * rng.Normal());
  EXPECT_THAT(Register(scene.Observe(noise), scene.reference(), RequestAbout(scene, scene.Nominal(), 2.0)).doubt,
              HasSubstr("does not match the scene"));
}

TEST(Registration, AnotherPlaceDoesNotMatch) {
  const SyntheticScene scene(61, 1);
  const SyntheticScene other(61, 2);
  const Image<float> frame = other.Frame(other.Nominal(), 1);
  EXPECT_THAT(Register(scene.Observe(frame), scene.reference(), RequestAbout(scene, scene.Nominal(), 2.0)).doubt,
              HasSubstr("does not match the scene"));
}

TEST(Registration, AMotionBeyondTheLimitIsNotBelieved) {
  const SyntheticScene scene(81);
  const View truth = scene.NominalMovedBy(Corners(3, 0, 3, 0, 3, 0));
  const Image<float> frame = scene.Frame(truth, 1);
  RegistrationRequest request = RequestAbout(scene, scene.Nominal(), 5.0);
  request.motion_px_max = 2.0;
  EXPECT_THAT(Register(scene.Observe(frame), scene.reference(), request).doubt, HasSubstr("would have moved 3.0 px"));
  request.motion_px_max = 4.0;
  EXPECT_EQ(Register(scene.Observe(frame), scene.reference(), request).doubt, "");
}

// Near enough for the descent to end somewhere that correlates, and far enough for that to be another place.
TEST(Registration, AutoCapturesFromNearAndFar) {
  constexpr int kCount = 30;
  Rng rng({12});
  for (const auto& [shift_px, turn_deg] : {std::pair{8.0, 6.0}, std::pair{16.0, 0.0}, std::pair{16.0, 12.0}}) {
    int captured = 0;
    for (std::uint64_t k = 0; k < kCount; ++k) {
      const SyntheticScene scene(151, 300 + k);
      const Image<float> frame = scene.Frame(scene.Nominal(), k);
      RegistrationRequest request =
          RequestAbout(scene, testing::TurnedAndMoved(scene, shift_px, turn_deg * std::numbers::pi / 180.0, &rng), 20.0);
      request.motion_px_max = 60.0;
      const JudgedRegistration judged = Register(scene.Observe(frame), scene.reference(), request);
      const double error_px = LargestCornerMotion(judged.registration.view.scene_from_sensor, scene.Nominal().scene_from_sensor, scene.roi);
      captured += judged.doubt.empty() && error_px < 0.25 ? 1 : 0;
    }
    EXPECT_GE(captured, 29) << "of 30 from " << shift_px << " px and " << turn_deg << " degrees";
  }
}

TEST(Registration, AnotherCandidateIsTriedWhenThePriorLeadsNowhere) {
  const SyntheticScene scene(81);
  const View truth = scene.Nominal();
  const Image<float> frame = scene.Frame(truth, 1);
  RegistrationRequest request = RequestAbout(scene, scene.NominalMovedBy(Corners(40, 0, 40, 0, 40, 0)), 40.0);
  request.method = RegistrationMethod::kGaussNewton;
  request.motion_px_max = 50.0;
  request.candidates = {truth};
  const JudgedRegistration judged = Register(scene.Observe(frame), scene.reference(), request);
  EXPECT_EQ(judged.doubt, "");
  EXPECT_LT(LargestCornerMotion(judged.registration.view.scene_from_sensor, truth.scene_from_sensor, scene.roi), 0.03);
}

}  // namespace
}  // namespace trem
