// Goal: the sensor's linear part and its adjoint belong together, and it does to a constant and to a shifted scene what a sensor does.
// Method: <A x, y> == <x, A' y> for random affine views and white noise; closed forms.
#include "worker/sensor/forward_operator.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/unit/worker/sensor/random_image.h"

namespace trem {
namespace {

Affine RandomView(Rng* rng) {
  Affine view;
  const double angle = 0.6 * (rng->Uniform() - 0.5);
  const double scale = 2.5 + rng->Uniform();
  view.linear << scale * std::cos(angle), -scale * std::sin(angle) * 1.05, scale * std::sin(angle), scale * std::cos(angle);
  // Partly outside the scene on purpose.
  view.offset = {20.0 * (rng->Uniform() - 0.4), 20.0 * (rng->Uniform() - 0.4)};
  return view;
}

TEST(ForwardOperator, TheAdjointIsTheAdjoint) {
  Rng rng({5});
  for (std::uint64_t seed = 0; seed < 12; ++seed) {
    ForwardOperator a(*MakePsf({0.55, 0.9}, 3), RandomView(&rng), 24, 19);
    const Image<float> x = RandomImage(80, 70, seed);
    const Image<float> y = RandomImage(24, 19, seed + 50);
    const double left = Dot(a.Apply(x), y);
    const double right = Dot(x, a.ApplyAdjoint(y, 80, 70));
    EXPECT_NEAR(left, right, 1e-4 * std::sqrt(Dot(y, y))) << "seed " << seed;
  }
}

TEST(ForwardOperator, AConstantSceneGivesAConstantFrameWhereItIsSeen) {
  Affine view;
  view.linear *= 3.0;
  view.offset = {4.3, 5.1};
  ForwardOperator a(*MakePsf({0.55, 0.9}, 3), view, 20, 20);
  const Image<float> frame = a.Apply(Image<float>(50, 80, 60.0F));
  EXPECT_NEAR(frame.at(3, 3), 60.0, 1e-3);
  EXPECT_NEAR(frame.at(3, 19), 60.0, 1e-3);
  EXPECT_EQ(frame.at(19, 3), 0.0F) << "4.3 + 57 leaves a scene of 50 cells";
}

}  // namespace
}  // namespace trem
