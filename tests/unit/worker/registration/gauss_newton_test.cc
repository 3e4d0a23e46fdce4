// Goal: Gauss-Newton finds the view, knows how well, and uses nothing that it must not use. Method: frames that are samples of the
// prediction plus white noise, at known views.
#include "worker/registration/gauss_newton.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>
#include <limits>
#include <numbers>

#include "mosaic/geometry/camera.h"
#include "tests/unit/worker/registration/synthetic_scene.h"

namespace trem {
namespace {

using testing::Corners;
using testing::SyntheticScene;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

double ErrorPx(const Registration& registration, const View& truth, const Roi& roi) {
  return LargestCornerMotion(registration.view.scene_from_sensor, truth.scene_from_sensor, roi);
}

TEST(GaussNewton, RecoversAnAffineViewWithGainAndOffset) {
  constexpr int kCount = 10;
  const SyntheticScene scene(101);
  Rng rng({7});
  double squares = 0.0;
  for (std::uint64_t k = 0; k < kCount; ++k) {
    const View truth = scene.NominalMovedBy(testing::RandomCorners(&rng, 1.0), 1.0 + 0.05 * rng.Normal(), 5.0 * rng.Normal());
    const Image<float> frame = scene.Frame(truth, k);
    const Registration found =
        RegisterGaussNewton(scene.Observe(frame), scene.reference(), scene.PriorAbout(scene.Nominal(), 5.0), scene.Nominal(), {});
    EXPECT_TRUE(found.converged);
    EXPECT_LT(ErrorPx(found, truth, scene.roi), 0.04) << "case " << k << ", the worst of four corners";
    squares += CornerDisplacement(found.view.scene_from_sensor, truth.scene_from_sensor, scene.roi).squaredNorm();
    EXPECT_NEAR(found.view.gain, truth.gain, 0.005);
    EXPECT_NEAR(found.view.offset, truth.offset, 0.6);
    EXPECT_NEAR(found.residual_rms, 2.0, 0.1);
    EXPECT_GT(found.correlation, 0.99);
    EXPECT_EQ(found.overlap, 1.0);
  }
  EXPECT_LT(std::sqrt(squares / (6.0 * kCount)), 0.02) << "rms of a corner coordinate, px";
}

// Over N = 120 frames the sum of d' C^-1 d is chi-square with 6 N degrees of freedom where C is right: its mean per degree has standard
// deviation sqrt(2 / 720) = 0.053. The limits are 5 of them (false alarm about 6e-7) and 5 % for what C leaves out: Huber's weights and
// the linearisation.
TEST(GaussNewton, TheCovarianceCoversTheTrueErrorAtItsRate) {
  constexpr int kCount = 120;
  const SyntheticScene scene(61, 3);
  Rng rng({8});
  double sum = 0.0;
  for (std::uint64_t k = 0; k < kCount; ++k) {
    const View truth = scene.NominalMovedBy(testing::RandomCorners(&rng, 0.5));
    const Image<float> frame = scene.Frame(truth, 1000 + k);
    const Registration found =
        RegisterGaussNewton(scene.Observe(frame), scene.reference(), scene.PriorAbout(scene.Nominal(), 5.0), scene.Nominal(), {});
    const CornerVector d = CornerDisplacement(found.view.scene_from_sensor, truth.scene_from_sensor, scene.roi);
    sum += d.dot(found.corner_covariance.ldlt().solve(d)) / 6.0;
  }
  const double mean = sum / kCount;
  const double limit = 5.0 * std::sqrt(2.0 / (6.0 * kCount)) + 0.05;
  EXPECT_NEAR(mean, 1.0, limit);
}

// A ROI of 401 px of a wide camera (640 px across 30 degrees) that looks down at 45 degrees, and the same camera moved: turned, rolled
// and carried on by 6 % of its distance. The scene plane is the first camera's sensor; the pointing follows all but 5 px of the motion of
// the ROI's centre.
TEST(GaussNewton, PerspectiveNeedsAProjectiveViewAndIsRecoveredByOne) {
  const SyntheticScene scene(401);
  constexpr double kDegree = std::numbers::pi / 180.0;
  const CameraIntrinsics camera{640, 512, FocalFromHorizontalFov(640, 30.0 * kDegree)};
  CameraPose first{{0.0, 0.0, 1000.0}, 0.1, -45.0 * kDegree, 0.0};
  CameraPose second{{40.0, 70.0, 1010.0}, 0.1 + 0.3 * kDegree, -45.4 * kDegree, 0.3 * kDegree};
  const Homography first_from_second = GroundFromSensor(first, camera, 0.0).Inverse() * GroundFromSensor(second, camera, 0.0);
  const Eigen::Vector2d centre(scene.roi.x0 + 200, scene.roi.y0 + 200);
  Affine pointing;
  pointing.offset = centre - first_from_second * centre + Eigen::Vector2d(4.0, 3.0);
  View truth;
  truth.scene_from_sensor = scene.Nominal().scene_from_sensor * PlanarMap(pointing) * PlanarMap::FromHomography(first_from_second);
  const Image<float> frame = scene.Frame(truth, 3);
  GaussNewtonOptions options;
  options.pyramid_levels = 3;
  const auto error = [&](ViewModel model) {
    const Registration found =
        RegisterGaussNewton(scene.Observe(frame), scene.reference(), scene.PriorAbout(scene.Nominal(), 20.0, model), scene.Nominal(), options);
    EXPECT_EQ(found.corner_covariance.rows(), ParameterCount(model));
    return ErrorPx(found, truth, scene.roi);
  };
  EXPECT_GT(error(ViewModel::kAffine), 0.3);
  EXPECT_LT(error(ViewModel::kProjective), 0.03);
}

// As for the affine view, with 8 degrees of freedom a frame.
TEST(GaussNewton, TheProjectiveCovarianceCoversTheTrueErrorAtItsRate) {
  constexpr int kCount = 60;
  const SyntheticScene scene(81, 3);
  Rng rng({9});
  double sum = 0.0;
  for (std::uint64_t k = 0; k < kCount; ++k) {
    CornerVector d(8);
    for (int i = 0; i < 8; ++i) d(i) = 0.5 * rng.Normal();
    const View truth = scene.NominalMovedBy(d);
    const Image<float> frame = scene.Frame(truth, 2000 + k);
    const Registration found = RegisterGaussNewton(scene.Observe(frame), scene.reference(),
                                                   scene.PriorAbout(scene.Nominal(), 5.0, ViewModel::kProjective), scene.Nominal(), {});
    const CornerVector error =
        CornerDisplacement(found.view.scene_from_sensor, truth.scene_from_sensor, scene.roi, ViewModel::kProjective);
    sum += error.dot(found.corner_covariance.ldlt().solve(error)) / 8.0;
  }
  EXPECT_NEAR(sum / kCount, 1.0, 5.0 * std::sqrt(2.0 / (8.0 * kCount)) + 0.05);
}

TEST(GaussNewton, CellsThatNobodyHasSeenAreNotUsed) {
  SyntheticScene scene(81);
  const View truth = scene.NominalMovedBy(Corners(0.4, -0.3, 0.5, 0.1, -0.2, 0.3));
  const Image<float> frame = scene.Frame(truth, 1);
  for (int y = 0; y < scene.seen.height(); ++y) {
    for (int x = scene.seen.width() / 2; x < scene.seen.width(); ++x) scene.seen.at(x, y) = 0.0F;
    // Beyond the reach of a seen cell's cubic support the values do not exist.
    for (int x = scene.seen.width() / 2 + 3; x < scene.seen.width(); ++x) scene.prediction.at(x, y) = 1e6F;
  }
  const Registration found =
      RegisterGaussNewton(scene.Observe(frame), scene.reference(), scene.PriorAbout(scene.Nominal(), 5.0), scene.Nominal(), {});
  EXPECT_NEAR(found.overlap, 0.5, 0.02);
  EXPECT_LT(ErrorPx(found, truth, scene.roi), 0.06) << "from half of the ROI";
}

TEST(GaussNewton, NanPixelsAreIgnored) {
  const SyntheticScene scene(81);
  const View truth = scene.NominalMovedBy(Corners(0.4, -0.3, 0.5, 0.1, -0.2, 0.3));
  Image<float> frame = scene.Frame(truth, 1);
  for (int y = 20; y < 45; ++y) {
    for (int x = 30; x < 60; ++x) frame.at(x, y) = kNan;
  }
  const Registration found =
      RegisterGaussNewton(scene.Observe(frame), scene.reference(), scene.PriorAbout(scene.Nominal(), 5.0), scene.Nominal(), {});
  EXPECT_TRUE(found.converged);
  EXPECT_LT(ErrorPx(found, truth, scene.roi), 0.02);
  EXPECT_NEAR(found.overlap, 1.0 - 25.0 * 30.0 / (81.0 * 81.0), 1e-9);
  EXPECT_TRUE(found.corner_covariance.allFinite());
}

TEST(GaussNewton, WithoutTextureTheViewStaysAtThePriorAndSaysSo) {
  SyntheticScene scene(61);
  for (float& cell : scene.prediction.pixels()) cell = 100.0F;
  const Image<float> frame = scene.Frame(scene.Nominal(), 1);
  const View mean = scene.NominalMovedBy(Corners(0.3, 0.3, 0.3, 0.3, 0.3, 0.3));
  const Registration found = RegisterGaussNewton(scene.Observe(frame), scene.reference(), scene.PriorAbout(mean, 0.7), mean, {});
  EXPECT_LT(ErrorPx(found, mean, scene.roi), 1e-3) << "what float rounding of a constant leaves as texture";
  EXPECT_LT((found.corner_covariance - 0.49 * CornerMatrix::Identity(6, 6)).norm(), 0.01);
}

TEST(GaussNewton, ThePyramidReachesTenPixels) {
  const SyntheticScene scene(101);
  GaussNewtonOptions options;
  options.pyramid_levels = 3;
  int found_count = 0;
  for (int k = 0; k < 8; ++k) {
    const double angle = 0.785 * k;
    const double x = 10.0 * std::cos(angle);
    const double y = 10.0 * std::sin(angle);
    const View truth = scene.NominalMovedBy(Corners(x, y, x, y, x, y));
    const Image<float> frame = scene.Frame(truth, static_cast<std::uint64_t>(k));
    const Registration found =
        RegisterGaussNewton(scene.Observe(frame), scene.reference(), scene.PriorAbout(scene.Nominal(), 20.0), scene.Nominal(), options);
    found_count += ErrorPx(found, truth, scene.roi) < 0.03 ? 1 : 0;
  }
  EXPECT_EQ(found_count, 8);
}

// A start 16 px away in a random direction and turned by 12 degrees, over other ground each time.
TEST(GaussNewton, ThePyramidCapturesFromSixteenPixelsAndTwelveDegrees) {
  constexpr int kCount = 40;
  GaussNewtonOptions options;
  options.pyramid_levels = 3;
  Rng rng({11});
  int captured = 0;
  for (std::uint64_t k = 0; k < kCount; ++k) {
    const SyntheticScene scene(151, 100 + k);
    const Image<float> frame = scene.Frame(scene.Nominal(), k);
    const View start = testing::TurnedAndMoved(scene, 16.0, 12.0 * std::numbers::pi / 180.0, &rng);
    const Registration found = RegisterGaussNewton(scene.Observe(frame), scene.reference(), scene.PriorAbout(start, 20.0), start, options);
    captured += ErrorPx(found, scene.Nominal(), scene.roi) < 0.25 ? 1 : 0;
  }
  EXPECT_GE(captured, 38) << "of 40: 95 %";
}

// SampleCubic in double precision, so that differences of a sum over a thousand pixels mean something.
double SampleExactly(const Image<float>& image, const Eigen::Vector2d& at) {
  const auto weights = [](double t) {
    return Eigen::Vector4d(((-0.5 * t + 1.0) * t - 0.5) * t, (1.5 * t - 2.5) * t * t + 1.0, ((-1.5 * t + 2.0) * t + 0.5) * t, (0.5 * t - 0.5) * t * t);
  };
  const int x = static_cast<int>(at.x());
  const int y = static_cast<int>(at.y());
  const Eigen::Vector4d wx = weights(at.x() - x);
  const Eigen::Vector4d wy = weights(at.y() - y);
  double sum = 0.0;
  for (int j = 0; j < 4; ++j) {
    for (int i = 0; i < 4; ++i) sum += wx(i) * wy(j) * image.at(x - 1 + i, y - 1 + j);
  }
  return sum;
}

// What is marginalised and what is profiled differ by the volume of gain and offset: with a prior so tight that there is none, and with
// plenty of contrast, they agree; the marginal mode must be a stationary point of its own density, found here by differences.
TEST(GaussNewton, TheMarginalModeIsAStationaryPointOfTheMarginalDensity) {
  SyntheticScene scene(31, 4);
  scene.noise_sigma = 15.0;
  const View truth = scene.NominalMovedBy(Corners(0.2, -0.1, 0.3, 0.1, -0.2, 0.2), 1.1, 4.0);
  const Image<float> frame = scene.Frame(truth, 5);
  const ViewPrior prior = scene.PriorAbout(scene.Nominal(), 50.0);
  GaussNewtonOptions options;
  options.huber_sigmas = 1e6;  // The weights are held in a step; without them the density is exact.
  options.step_tolerance_px = 1e-6;
  options.iterations_max = 100;
  // -log of the marginal density over gain and offset, up to a constant.
  const auto density = [&](const View& view) {
    Eigen::Matrix2d a = Eigen::Vector2d(1.0 / std::pow(prior.gain_sigma, 2), 1.0 / std::pow(prior.offset_sigma, 2)).asDiagonal();
    Eigen::Vector2d b = a * Eigen::Vector2d(prior.mean.gain, prior.mean.offset);
    const double variance = scene.noise_sigma * scene.noise_sigma;
    double squares = a(0, 0) * std::pow(prior.mean.gain, 2) + a(1, 1) * std::pow(prior.mean.offset, 2);
    for (int v = 0; v < scene.roi.height(); ++v) {
      for (int u = 0; u < scene.roi.width(); ++u) {
        const Eigen::Vector2d cell = view.scene_from_sensor * Eigen::Vector2d(scene.roi.x0 + u, scene.roi.y0 + v) - Eigen::Vector2d(scene.x0, scene.y0);
        const double w = static_cast<double>(SyntheticScene::kSeen) / (SyntheticScene::kSeen + 1.0) / variance;
        const Eigen::Vector2d p(SampleExactly(scene.prediction, cell), 1.0);
        a += w * p * p.transpose();
        b += w * frame.at(u, v) * p;
        squares += w * frame.at(u, v) * frame.at(u, v);
      }
    }
    const CornerVector d = CornerDisplacement(prior.mean.scene_from_sensor, view.scene_from_sensor, scene.roi);
    return 0.5 * (squares - b.dot(a.ldlt().solve(b)) + d.dot(prior.information * d)) + 0.5 * std::log(a.determinant());
  };
  const auto slope = [&](const View& view) {
    CornerVector gradient(6);
    for (int k = 0; k < 6; ++k) {
      CornerVector step = CornerVector::Zero(6);
      step(k) = 2e-3;
      const View forward{Displace(view.scene_from_sensor, scene.roi, step)};
      const View backward{Displace(view.scene_from_sensor, scene.roi, -step)};
      gradient(k) = (density(forward) - density(backward)) / 4e-3;
    }
    return gradient;
  };
  const auto find = [&](GainOffset treatment) {
    options.gain_offset = treatment;
    return RegisterGaussNewton(scene.Observe(frame), scene.reference(), prior, scene.Nominal(), options);
  };
  const double marginal = slope(find(GainOffset::kMarginalised).view).norm();
  const double profiled = slope(find(GainOffset::kMaximumLikelihood).view).norm();
  EXPECT_GT(profiled, 0.01) << "else the test cannot tell them apart";
  EXPECT_LT(marginal, 0.15 * profiled);
}

// Pixels of weight 0 hold a strong false pattern that moves the other way; at every level of the pyramid they must not count.
TEST(GaussNewton, WeightsAreHonouredAtEveryLevel) {
  const SyntheticScene scene(121);
  const SyntheticScene other(121, 77);
  const View truth = scene.NominalMovedBy(Corners(9, 4, 9, 4, 9, 4));
  Image<float> frame = scene.Frame(truth, 1);
  const Image<float> wrong = other.Frame(other.Nominal(), 2);
  Image<float> weights(121, 121, 1.0F);
  for (int y = 0; y < 121; ++y) {
    for (int x = 0; x < 121; ++x) {
      if (x < 40 || (x + y) % 11 == 0) {
        frame.at(x, y) = 3.0F * wrong.at(x, y);
        weights.at(x, y) = 0.0F;
      }
    }
  }
  Observation observation = scene.Observe(frame);
  observation.weights = &weights;
  GaussNewtonOptions options;
  options.pyramid_levels = 3;
  const Registration found =
      RegisterGaussNewton(observation, scene.reference(), scene.PriorAbout(scene.Nominal(), 20.0), scene.Nominal(), options);
  EXPECT_TRUE(found.converged);
  EXPECT_LT(ErrorPx(found, truth, scene.roi), 0.05);
}

TEST(GaussNewton, OffTheSceneThereIsNoOverlapAndNoConvergence) {
  const SyntheticScene scene(61);
  const Image<float> frame = scene.Frame(scene.Nominal(), 1);
  const View far = scene.NominalMovedBy(Corners(500, 0, 500, 0, 500, 0));
  const Registration found = RegisterGaussNewton(scene.Observe(frame), scene.reference(), scene.PriorAbout(far, 1.0), far, {});
  EXPECT_LT(found.overlap, 0.05);
  EXPECT_FALSE(found.converged);
}

}  // namespace
}  // namespace trem
