// Goal: the prediction of a target follows it, takes the camera's motion out, and is as uncertain as it says. Method: simulated paths with
// the model's own accelerations; the share of errors within one and two standard deviations.
#include "worker/tre/target_motion.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include <cmath>

#include "mosaic/base/rng.h"

namespace trem {
namespace {

TEST(TargetMotion, AJerkOfTheCameraThatWasMeasuredIsNotOneOfTheTarget) {
  TargetMotion motion({50.0, 40.0}, Eigen::Vector2d::Zero(), 4.0);
  Eigen::Vector2d truth(50.0, 40.0);
  for (int t = 1; t < 30; ++t) {
    const Affine camera{Eigen::Rotation2Dd(0.02).toRotationMatrix(), Eigen::Vector2d(t % 3 == 0 ? 14.0 : -7.0, 2.0)};
    truth = camera * (truth + Eigen::Rotation2Dd(0.02 * t) * Eigen::Vector2d(1.5, 0.5));
    motion.Step(camera);
    if (t > 6) {
      EXPECT_LT((motion.position() - truth).norm(), 0.6) << t;
    }
    motion.Measure(truth, 0.1);
  }
}

TEST(TargetMotion, UncertaintyGrowsWhileLostAndCoversTheErrorAtItsNominalRate) {
  int within_one = 0;
  int within_two = 0;
  int count = 0;
  for (std::uint64_t seed = 0; seed < 400; ++seed) {
    Rng rng({seed, 3});
    Eigen::Vector2d truth(100.0, 100.0);
    Eigen::Vector2d velocity(2.0 * rng.Normal(), 2.0 * rng.Normal());
    TargetMotion motion(truth, Eigen::Vector2d::Zero(), 2.0);
    double before = 0.0;
    for (int t = 0; t < 24; ++t) {
      const Eigen::Vector2d jerk = TargetMotion::kAccelerationPx * Eigen::Vector2d(rng.Normal(), rng.Normal());
      truth += velocity + 0.5 * jerk;
      velocity += jerk;
      motion.Step(Affine{});
      if (t < 12) {
        motion.Measure(truth + 0.2 * Eigen::Vector2d(rng.Normal(), rng.Normal()), 0.2);
      } else {
        EXPECT_GT(motion.sigma_px(), before);
      }
      before = motion.sigma_px();
    }
    for (const double error : {motion.position().x() - truth.x(), motion.position().y() - truth.y()}) {
      ++count;
      within_one += std::abs(error) < motion.sigma_px() ? 1 : 0;
      within_two += std::abs(error) < 2.0 * motion.sigma_px() ? 1 : 0;
    }
  }
  // 800 coordinates: standard error of the shares 1.6 % and 0.8 %; bounds at three of them.
  EXPECT_NEAR(static_cast<double>(within_one) / count, 0.683, 0.05);
  EXPECT_NEAR(static_cast<double>(within_two) / count, 0.954, 0.024);
}

TEST(TargetMotion, ACameraMotionThatWasNotMeasuredWidensThePrediction) {
  TargetMotion known({0.0, 0.0}, Eigen::Vector2d::Zero(), 0.1);
  TargetMotion unknown = known;
  known.Step(Affine{});
  unknown.Step(std::nullopt);
  EXPECT_GT(unknown.sigma_px(), known.sigma_px() + 3.0);
}

}  // namespace
}  // namespace trem
