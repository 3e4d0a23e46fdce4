// Goal: successive frames are registered whatever lies between them (hops, rotation, scale, gain, offset, noise, low texture), to a
// fraction of a pixel, and unrelated frames are not. Method: frames rendered from one analytic texture through known affine maps; the
// error is the largest displacement over the frame's corners.
#include "worker/sortie/frame_motion.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>

#include "mosaic/base/rng.h"
#include "tests/unit/worker/sortie/test_video.h"

namespace trem {
namespace {

constexpr int kWidth = 640;
constexpr int kHeight = 480;

// A ground of smooth bumps and sharp-edged blobs, defined at any point.
class Ground {
 public:
  explicit Ground(std::uint64_t seed) {
    Rng rng({seed, 5});
    for (Blob& blob : blobs_) {
      blob = {1600.0 * rng.Uniform() - 480.0, 1400.0 * rng.Uniform() - 460.0, 4.0 + 40.0 * rng.Uniform() * rng.Uniform(),
              60.0 * rng.Uniform() - 30.0};
    }
  }
  // Renders the frame whose pixel u shows the ground at ground_from_sensor * u.
  Image<float> Render(const Affine& ground_from_sensor, double contrast = 1.0) const {
    Image<float> frame(kWidth, kHeight, 120.0F);
    const Affine sensor_from_ground = ground_from_sensor.Inverse();
    for (const Blob& blob : blobs_) {
      const Eigen::Vector2d centre = sensor_from_ground * Eigen::Vector2d(blob.x, blob.y);
      const double reach = 2.5 * blob.radius;
      const int x0 = std::max(0, static_cast<int>(centre.x() - reach)), x1 = std::min(kWidth - 1, static_cast<int>(centre.x() + reach));
      const int y0 = std::max(0, static_cast<int>(centre.y() - reach)), y1 = std::min(kHeight - 1, static_cast<int>(centre.y() + reach));
      for (int y = y0; y <= y1; ++y) {
        for (int x = x0; x <= x1; ++x) {
          const Eigen::Vector2d ground = ground_from_sensor * Eigen::Vector2d(x, y);
          const double distance = std::hypot(ground.x() - blob.x, ground.y() - blob.y);
          frame.at(x, y) += static_cast<float>(contrast * blob.height / (1.0 + std::exp((distance - blob.radius) / 1.0)));
        }
      }
    }
    return frame;
  }

 private:
  struct Blob {
    double x = 0, y = 0, radius = 0, height = 0;
  };
  std::array<Blob, 500> blobs_;
};

Affine Motion(double dx, double dy, double rotation_deg, double scale) {
  const double angle = rotation_deg * M_PI / 180.0;
  const Eigen::Vector2d centre(0.5 * (kWidth - 1), 0.5 * (kHeight - 1));
  Affine motion;
  motion.linear << scale * std::cos(angle), -scale * std::sin(angle), scale * std::sin(angle), scale * std::cos(angle);
  motion.offset = centre + Eigen::Vector2d(dx, dy) - motion.linear * centre;
  return motion;
}

Image<float> WithNoise(Image<float> frame, double sigma, double gain, double offset, std::uint64_t seed) {
  Rng rng({seed});
  for (float& value : frame.pixels()) value = static_cast<float>(gain * value + offset + sigma * rng.Normal());
  return frame;
}

double CornerError(const Affine& found, const Affine& truth) {
  double worst = 0.0;
  for (const Eigen::Vector2d& corner :
       {Eigen::Vector2d(0, 0), Eigen::Vector2d(kWidth - 1, 0), Eigen::Vector2d(0, kHeight - 1), Eigen::Vector2d(kWidth - 1, kHeight - 1)}) {
    const Eigen::Vector2d difference = found * corner - truth * corner;
    worst = std::max(worst, difference.norm());
  }
  return worst;
}

std::optional<MotionLink> LinkOf(const Image<float>& previous, const Image<float>& current) {
  FrameMotion motion(kWidth, kHeight, {0, 0, kWidth, kHeight});
  EXPECT_FALSE(motion.Link(ReduceFrame(previous)).has_value());
  return motion.Link(ReduceFrame(current));
}

TEST(FrameMotion, MeasuresSmallMotionToAFractionOfAPixel) {
  const Ground ground(1);
  const Affine truth = Motion(3.3, -2.6, 0.4, 1.002);
  const auto link = LinkOf(ground.Render({}), ground.Render(truth));
  ASSERT_TRUE(link.has_value());
  EXPECT_LT(CornerError(link->previous_from_current, truth), 0.25);
  EXPECT_GT(link->correlation, 0.95);
}

TEST(FrameMotion, SurvivesHopsWithRotationScaleGainOffsetAndNoise) {
  const Ground ground(2);
  Rng rng({77});
  for (int trial = 0; trial < 12; ++trial) {
    const double direction = 2.0 * M_PI * rng.Uniform();
    const double hop_px = 30.0 + 70.0 * rng.Uniform();
    const Affine truth =
        Motion(hop_px * std::cos(direction), hop_px * std::sin(direction), 10.0 * rng.Uniform() - 5.0, 0.95 + 0.1 * rng.Uniform());
    const auto link = LinkOf(WithNoise(ground.Render({}), 4.0, 1.0, 0.0, 1), WithNoise(ground.Render(truth), 4.0, 0.6, 70.0, 2));
    ASSERT_TRUE(link.has_value()) << "trial " << trial;
    EXPECT_LT(CornerError(link->previous_from_current, truth), 0.6) << "trial " << trial;
  }
}

TEST(FrameMotion, FindsALargeTurnByFeatures) {
  const Ground ground(3);
  const Affine truth = Motion(40.0, -60.0, 35.0, 1.1);
  const auto link = LinkOf(ground.Render({}), ground.Render(truth));
  ASSERT_TRUE(link.has_value());
  EXPECT_LT(CornerError(link->previous_from_current, truth), 1.0);
}

TEST(FrameMotion, WorksAtLowContrastInNoise) {
  const Ground ground(4);
  const Affine truth = Motion(15.0, 9.0, 1.0, 1.0);
  // Structure of about 3 grey levels rms under noise of 3.
  const auto link = LinkOf(WithNoise(ground.Render({}, 0.12), 3.0, 1.0, 0.0, 5), WithNoise(ground.Render(truth, 0.12), 3.0, 1.0, 0.0, 6));
  ASSERT_TRUE(link.has_value());
  EXPECT_LT(CornerError(link->previous_from_current, truth), 1.5);
}

TEST(FrameMotion, SeesACutBetweenUnrelatedFrames) {
  for (std::uint64_t seed = 10; seed < 16; ++seed) {
    EXPECT_FALSE(LinkOf(Ground(seed).Render({}), Ground(seed + 100).Render({})).has_value()) << "seed " << seed;
  }
}

TEST(FrameMotion, SeesACutAgainstPureNoiseAndGoesOnAfterIt) {
  const Ground ground(5);
  FrameMotion motion(kWidth, kHeight, {0, 0, kWidth, kHeight});
  EXPECT_FALSE(motion.Link(ReduceFrame(ground.Render({}))).has_value());
  EXPECT_FALSE(motion.Link(ReduceFrame(WithNoise(Image<float>(kWidth, kHeight, 100.0F), 5.0, 1.0, 0.0, 8))).has_value());
  EXPECT_FALSE(motion.Link(ReduceFrame(ground.Render({}))).has_value());
  EXPECT_TRUE(motion.Link(ReduceFrame(ground.Render(Motion(2, 3, 0, 1)))).has_value());
}

TEST(FrameMotion, IgnoresWhatLiesOutsideTheValidRoi) {
  const Ground ground(6);
  const Affine truth = Motion(11.0, 4.0, 0.0, 1.0);
  const auto with_border = [](Image<float> frame) {
    for (int y = 0; y < kHeight; ++y) std::fill_n(frame.row(y), 40, 0.0F);
    return frame;
  };
  FrameMotion motion(kWidth, kHeight, {42, 0, kWidth, kHeight});
  EXPECT_FALSE(motion.Link(ReduceFrame(with_border(ground.Render({})))).has_value());
  const auto link = motion.Link(ReduceFrame(with_border(ground.Render(truth))));
  ASSERT_TRUE(link.has_value());
  EXPECT_LT(CornerError(link->previous_from_current, truth), 0.25);
}

TEST(FrameMotion, GivesTheSameBitsEveryTime) {
  const Ground ground(7);
  const Image<float> a = WithNoise(ground.Render({}), 4.0, 1.0, 0.0, 1);
  const Image<float> b = WithNoise(ground.Render(Motion(40.0, -60.0, 30.0, 1.1)), 4.0, 1.0, 0.0, 2);
  const auto first = LinkOf(a, b);
  const auto second = LinkOf(a, b);
  ASSERT_TRUE(first.has_value() && second.has_value());
  EXPECT_EQ(first->previous_from_current.linear, second->previous_from_current.linear);
  EXPECT_EQ(first->previous_from_current.offset, second->previous_from_current.offset);
}

}  // namespace
}  // namespace trem
