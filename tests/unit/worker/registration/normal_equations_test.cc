// Goal: the vectorised normal equations are Gauss-Newton's, and their bytes do not depend on the machine.
// Method: a plain double-precision loop over the pixels with an Eigen Jacobian as the reference, over views, models, strides, weights,
// holes; and the same row on every instruction set that this processor has.
#include "worker/registration/normal_equations.h"

#include <gtest/gtest.h>
#include <hwy/targets.h>

#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <vector>

#include "tests/unit/worker/registration/synthetic_scene.h"

namespace trem {
namespace {

using testing::SyntheticScene;

constexpr double kNoise = 2.0;
constexpr double kHuber = 3.0;

struct Plain {
  ParameterMatrix a;
  Parameters b;
  double w = 0.0, wr2 = 0.0, seen = 0.0, wi = 0.0, wi2 = 0.0;
  long long pixels = 0, candidates = 0;
};

Plain PlainNormal(const RegistrationLevel& level, const Roi& roi, const Reference& reference, const View& view, ViewModel model) {
  const int corners = ParameterCount(model);
  Plain plain{ParameterMatrix::Zero(corners + 2, corners + 2), Parameters::Zero(corners + 2)};
  for (int v = level.pixel_stride / 2; v < level.frame->height(); v += level.pixel_stride) {
    for (int u = level.pixel_stride / 2; u < level.frame->width(); u += level.pixel_stride) {
      ++plain.candidates;
      const double pixel = level.frame->at(u, v);
      const double trust = level.weights != nullptr ? level.weights->at(u, v) : 1.0;
      const Eigen::Vector2d sensor(roi.x0 + FullFromLevel(u, level.frame_step), roi.y0 + FullFromLevel(v, level.frame_step));
      const Eigen::Vector2d scene = view.scene_from_sensor * sensor;
      const double x = LevelFromFull(scene.x() - reference.x0, level.reference_step);
      const double y = LevelFromFull(scene.y() - reference.y0, level.reference_step);
      if (std::isnan(pixel) || !(trust > 0.0) || !CubicSupported(*level.prediction, x, y)) continue;
      const double n = level.seen->at(static_cast<int>(x + 0.5), static_cast<int>(y + 0.5));
      if (!(n >= reference.seen_min)) continue;
      const ValueAndGradient p = SampleCubicGradient(*level.prediction, x, y);
      const double r = pixel - view.gain * p.value - view.offset;
      const double seen = trust * n / (n + 1.0);
      const double w = seen * std::min(1.0, kHuber * kNoise / std::abs(r));
      const Eigen::RowVector2d slope =
          view.gain / level.reference_step * Eigen::RowVector2d(p.dx, p.dy) * view.scene_from_sensor.LinearisedAt(sensor).linear;
      Parameters j(corners + 2);
      j << (slope * CornerJacobian(roi, sensor, model)).transpose(), p.value, 1.0;
      plain.a += w / (kNoise * kNoise) * j * j.transpose();
      plain.b += w / (kNoise * kNoise) * r * j;
      plain.w += w;
      plain.wr2 += w * r * r;
      plain.seen += seen;
      plain.wi += w * pixel;
      plain.wi2 += w * pixel * pixel;
      ++plain.pixels;
    }
  }
  return plain;
}

// A frame of the scene with holes, a patch that nobody has seen, and weights of 0, 1/2 and 1.
struct Setting {
  SyntheticScene scene{70, 5};
  Image<float> frame;
  Image<float> weights{70, 70, 1.0F};

  Setting() {
    frame = scene.Frame(scene.Nominal(), 1);
    for (int k = 0; k < 70; ++k) {
      frame.at(k, (7 * k) % 70) = std::numeric_limits<float>::quiet_NaN();
      weights.at((3 * k) % 70, k) = 0.5F;
      weights.at((5 * k) % 70, k) = 0.0F;
      frame.at((11 * k) % 70, k) += 40.0F;  // For the robust weights.
    }
    for (int y = 100; y < 160; ++y) {
      for (int x = 120; x < 200; ++x) scene.seen.at(x, y) = static_cast<float>((x + y) % 3);
    }
  }
};

View RandomView(const SyntheticScene& scene, ViewModel model, Rng* rng) {
  CornerVector d(ParameterCount(model));
  for (Eigen::Index k = 0; k < d.size(); ++k) d(k) = 2.0 * rng->Normal();
  return scene.NominalMovedBy(d, 1.0 + 0.1 * rng->Normal(), 3.0 * rng->Normal());
}

void ExpectLikePlain(const RegistrationLevel& level, const SyntheticScene& scene, const View& view, ViewModel model) {
  const Plain plain = PlainNormal(level, scene.roi, scene.reference(), view, model);
  ResidualHistogram histogram;
  const NormalEquations fast = AccumulateNormal(level, scene.roi, scene.reference(), view, model, kNoise, kHuber, &histogram);
  // Cells on the edge of what is seen, or of the image, may fall to either side in float: a few pixels of 1/70^2.
  EXPECT_NEAR(static_cast<double>(fast.pixels), static_cast<double>(plain.pixels), 3.0);
  EXPECT_EQ(fast.candidates, plain.candidates);
  const double tolerance = fast.pixels == plain.pixels ? 3e-5 : 3e-3;
  const Eigen::VectorXd scale = plain.a.diagonal().cwiseSqrt();
  for (Eigen::Index i = 0; i < plain.a.rows(); ++i) {
    for (Eigen::Index k = 0; k < plain.a.rows(); ++k)
      EXPECT_NEAR(fast.a(i, k), plain.a(i, k), tolerance * scale(i) * scale(k)) << i << " " << k;
    EXPECT_NEAR(fast.b(i), plain.b(i), tolerance * scale(i) * std::sqrt(plain.wr2) / kNoise) << i;
  }
  EXPECT_NEAR(fast.robust_weight, plain.w, tolerance * plain.w);
  EXPECT_NEAR(fast.seen_weight, plain.seen, tolerance * plain.seen);
  EXPECT_NEAR(fast.sum_w_r2, plain.wr2, tolerance * plain.wr2);
  EXPECT_NEAR(fast.sum_w_i, plain.wi, tolerance * plain.wi);
  EXPECT_NEAR(fast.sum_w_i2, plain.wi2, tolerance * plain.wi2);
  EXPECT_GT(histogram.total, fast.pixels / 3);
}

TEST(NormalEquations, AreThePlainLoopsForEveryModelStrideAndWeight) {
  const Setting setting;
  Rng rng({1});
  for (const ViewModel model : {ViewModel::kAffine, ViewModel::kProjective}) {
    for (const int stride : {1, 2, 3, 6}) {
      for (const Image<float>* weights : {static_cast<const Image<float>*>(nullptr), &setting.weights}) {
        RegistrationLevel level{&setting.frame, weights, &setting.scene.prediction, &setting.scene.seen};
        level.pixel_stride = stride;
        ExpectLikePlain(level, setting.scene, RandomView(setting.scene, model, &rng), model);
      }
    }
  }
}

TEST(NormalEquations, AnAffineModelAboutAProjectiveViewHasTheViewsOwnSlopes) {
  const Setting setting;
  Rng rng({2});
  const RegistrationLevel level{&setting.frame, nullptr, &setting.scene.prediction, &setting.scene.seen};
  ExpectLikePlain(level, setting.scene, RandomView(setting.scene, ViewModel::kProjective, &rng), ViewModel::kAffine);
}

TEST(NormalEquations, PartlyOffTheSceneOnlyWhatLiesOnItCounts) {
  const Setting setting;
  const RegistrationLevel level{&setting.frame, nullptr, &setting.scene.prediction, &setting.scene.seen};
  for (const double far : {30.0, 60.0, 90.0, 1e4, -35.0}) {
    const View view = setting.scene.NominalMovedBy(testing::Corners(far, 0.3, far, 0.3, far, 0.3));
    if (far < 80.0) {
      ExpectLikePlain(level, setting.scene, view, ViewModel::kAffine);
    } else {
      const NormalEquations normal =
          AccumulateNormal(level, setting.scene.roi, setting.scene.reference(), view, ViewModel::kAffine, kNoise, kHuber, nullptr);
      EXPECT_EQ(normal.pixels, 0);
      EXPECT_TRUE(normal.a.isZero());
    }
  }
}

TEST(NormalEquations, AViewThatIsNotFiniteUsesNoPixel) {
  const Setting setting;
  const RegistrationLevel level{&setting.frame, nullptr, &setting.scene.prediction, &setting.scene.seen};
  View view = setting.scene.Nominal();
  view.scene_from_sensor.offset.x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(AccumulateNormal(level, setting.scene.roi, setting.scene.reference(), view, ViewModel::kAffine, kNoise, kHuber, nullptr).pixels,
            0);
}

TEST(NormalEquations, EveryInstructionSetGivesTheSameBytes) {
  const Setting setting;
  Rng rng({3});
  const RegistrationLevel level{&setting.frame, &setting.weights, &setting.scene.prediction, &setting.scene.seen};
  const std::vector<std::int64_t> targets = hwy::SupportedAndGeneratedTargets();
  for (const ViewModel model : {ViewModel::kAffine, ViewModel::kProjective}) {
    const View view = RandomView(setting.scene, model, &rng);
    const auto normal = [&] {
      return AccumulateNormal(level, setting.scene.roi, setting.scene.reference(), view, model, kNoise, kHuber, nullptr);
    };
    const NormalEquations best = normal();
    int tried = 0;
    for (const auto target : targets) {
      hwy::SetSupportedTargetsForTest(target);
      hwy::GetChosenTarget().Update(hwy::SupportedTargets());
      const NormalEquations other = normal();
      EXPECT_EQ(std::memcmp(best.a.data(), other.a.data(), sizeof(double) * static_cast<std::size_t>(best.a.size())), 0)
          << hwy::TargetName(target);
      EXPECT_EQ(std::memcmp(best.b.data(), other.b.data(), sizeof(double) * static_cast<std::size_t>(best.b.size())), 0)
          << hwy::TargetName(target);
      ++tried;
    }
    hwy::SetSupportedTargetsForTest(0);
    hwy::GetChosenTarget().Update(hwy::SupportedTargets());
    EXPECT_GE(tried, 1);
  }
}

TEST(ResidualHistogram, TheMedianIsInterpolated) {
  ResidualHistogram histogram;
  EXPECT_EQ(histogram.Median(), 0.0);
  for (int bin = 0; bin < 128; ++bin) histogram.counts[static_cast<std::size_t>(bin)] = 10;
  histogram.total = 1280;
  EXPECT_NEAR(histogram.Median(), 1.0, 1e-12);
  histogram.total = 1280 * 3;
  EXPECT_EQ(histogram.Median(), 16.0);
}

}  // namespace
}  // namespace trem
