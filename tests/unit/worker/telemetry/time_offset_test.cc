// Goal: the offset between a telemetry's clock and the frames' is found from the image motion, with an error that its sigma covers, and is
// not claimed where nothing determines it. Method: a swaying camera; motion computed from its true path at shifted times, with noise.
#include "worker/telemetry/time_offset.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "mosaic/base/rng.h"
#include "mosaic/geometry/camera.h"

namespace trem {
namespace {

using ::testing::HasSubstr;

constexpr double kRad = std::numbers::pi / 180.0;
constexpr int kWidth = 640;
constexpr int kHeight = 480;
constexpr double kHfov_deg = 20.0;

// Straight and level, with a sway of the pitch and yaw of `sway_deg`.
CameraSample PathAt(double t, double sway_deg) {
  CameraSample sample;
  sample.time_s = t;
  sample.latitude_deg = 46.0;
  sample.longitude_deg = 7.0 + 2e-4 * t / std::cos(46.0 * kRad);
  sample.altitude_m = 500.0;
  sample.yaw_deg = 30.0 + sway_deg * std::sin(1.3 * t);
  sample.pitch_deg = -60.0 + sway_deg * std::sin(2.1 * t + 1.0);
  sample.hfov_deg = kHfov_deg;
  return sample;
}

Homography GroundAt(double t, double sway_deg) {
  const CameraSample s = PathAt(t, sway_deg);
  CameraPose pose;
  pose.position_m << (s.longitude_deg - 7.0) * 111320.0 * std::cos(46.0 * kRad), 0.0, s.altitude_m;
  pose.yaw_rad = s.yaw_deg * kRad;
  pose.pitch_rad = s.pitch_deg * kRad;
  return GroundFromSensor(pose, {kWidth, kHeight, FocalFromHorizontalFov(kWidth, kHfov_deg * kRad)}, 0.0);
}

TimeOffset Estimate(double offset_s, double sway_deg, double noise_px, std::uint64_t seed) {
  std::vector<CameraSample> samples;
  for (int i = 0; i <= 400; ++i) samples.push_back(PathAt(0.05 * i, sway_deg));
  std::vector<MeasuredMotion> motions;
  const Eigen::Vector2d middle(0.5 * (kWidth - 1), 0.5 * (kHeight - 1));
  Rng rng({seed});
  for (int i = 0; i < 300; ++i) {
    const double t = 3.0 + 0.04 * i;
    const Eigen::Vector2d shift = GroundAt(t - 0.04 + offset_s, sway_deg).Inverse() * (GroundAt(t + offset_s, sway_deg) * middle) - middle;
    motions.push_back({t - 0.04, t, shift + noise_px * Eigen::Vector2d(rng.Normal(), rng.Normal())});
  }
  return EstimateTimeOffset(TelemetryTrack(samples), motions, {{kWidth, kHeight, 0.0}, 2.0, 0.02});
}

TEST(TimeOffset, FindsTheOffsetOfASwayingCamera) {
  for (const double truth_s : {-0.73, 0.31, 1.2}) {
    const TimeOffset offset = Estimate(truth_s, 0.5, 0.2, 7);
    ASSERT_TRUE(offset.determined) << offset.reason;
    EXPECT_NEAR(offset.offset_s, truth_s, 0.02);
    EXPECT_LT(offset.rms_px, offset.rms_at_zero_px);
  }
}

TEST(TimeOffset, ItsSigmaCoversTheError) {
  // Of 20 errors with normal distribution 4 sigma are exceeded with a chance of 0.13 %.
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    const TimeOffset offset = Estimate(0.4, 0.5, 0.5, seed);
    ASSERT_TRUE(offset.determined) << "seed " << seed << " " << offset.reason;
    EXPECT_LT(std::abs(offset.offset_s - 0.4), 4.0 * offset.sigma_s + 0.002) << "seed " << seed;
  }
}

TEST(TimeOffset, IsNotClaimedForAnEvenFlightNorForFewFramesNorWhereNoneIsNeeded) {
  const TimeOffset even = Estimate(0.5, 0.0, 0.5, 3);
  EXPECT_FALSE(even.determined);
  const TimeOffset none = Estimate(0.0, 0.5, 0.2, 3);
  EXPECT_FALSE(none.determined);
  EXPECT_THAT(none.reason, HasSubstr("none is needed"));
  const TimeOffset few = EstimateTimeOffset(TelemetryTrack({PathAt(0.0, 0.0), PathAt(1.0, 0.0)}), {}, {{kWidth, kHeight, 0.0}, 2.0, 0.02});
  EXPECT_FALSE(few.determined);
  EXPECT_THAT(few.reason, HasSubstr("0 pairs of frames"));
}

// Poses whose yaw runs away by `wander_deg` (a ramp from minus to plus) while the images follow the true path.
PoseWander Wander(double wander_deg) {
  std::vector<CameraSample> samples;
  std::vector<MeasuredLink> links;
  for (int i = 0; i <= 40; ++i) {
    CameraSample sample = PathAt(0.05 * i, 0.5);
    sample.yaw_deg += wander_deg * (i - 20) / 20.0 / std::cos(60.0 * kRad);
    samples.push_back(sample);
    const Homography motion = GroundAt(0.05 * std::max(0, i - 1), 0.5).Inverse() * GroundAt(0.05 * i, 0.5);
    links.push_back({0.05 * i, motion.LinearisedAt({0.5 * (kWidth - 1), 0.5 * (kHeight - 1)})});
  }
  links[0].previous_from_current.reset();
  const auto wander = MeasureWander(TelemetryTrack(samples), links, {kWidth, kHeight, 0.0});
  EXPECT_TRUE(wander.has_value());
  return wander.value_or(PoseWander{});
}

TEST(PoseWander, MeasuresHowFarPosesRunAwayFromTheImages) {
  EXPECT_LT(Wander(0.0).rms_deg, 0.01);
  // A ramp of +-1 degree has an rms of 1 / sqrt(3), on one of two axes.
  EXPECT_NEAR(Wander(1.0).rms_deg, 1.0 / std::sqrt(6.0), 0.05);
}

TEST(PoseWander, PointingErrorsBringPosesBackToWhatTheImagesShow) {
  std::vector<CameraSample> samples;
  std::vector<MeasuredLink> links;
  for (int i = 0; i <= 40; ++i) {
    CameraSample sample = PathAt(0.05 * i, 0.5);
    sample.yaw_deg += (i - 20) / 20.0;
    sample.pitch_deg -= 0.5 * (i - 20) / 20.0;
    samples.push_back(sample);
    const Homography motion = GroundAt(0.05 * std::max(0, i - 1), 0.5).Inverse() * GroundAt(0.05 * i, 0.5);
    links.push_back({0.05 * i, motion.LinearisedAt({0.5 * (kWidth - 1), 0.5 * (kHeight - 1)})});
  }
  links[0].previous_from_current.reset();
  const MotionGeometry geometry{kWidth, kHeight, 0.0};
  const std::vector<Eigen::Vector2d> errors = PointingErrors(TelemetryTrack(samples), links, geometry);
  for (std::size_t i = 0; i < samples.size(); i += 5) {
    const CameraSample repointed = Repointed(samples[i], errors[i], geometry);
    const CameraSample truth = PathAt(0.05 * static_cast<double>(i), 0.5);
    EXPECT_NEAR(repointed.yaw_deg, truth.yaw_deg, 0.04) << i;
    EXPECT_NEAR(repointed.pitch_deg, truth.pitch_deg, 0.02) << i;
  }
}

TEST(PictureTurn, TurnedPicturesAreRecognisedByTheirMotion) {
  // Straight down, 20 m forward a second.
  std::vector<CameraSample> samples;
  for (int i = 0; i < 6; ++i) {
    CameraSample sample = PathAt(i, 0.0);
    sample.pitch_deg = -90.0;
    samples.push_back(sample);
  }
  const TelemetryTrack track(samples);
  const MotionGeometry geometry{kWidth, kHeight, 0.0};
  for (const int quarters : {0, 1, 2, -1}) {
    std::vector<MeasuredLink> links = {{0.0, std::nullopt}};
    for (int i = 1; i < 6; ++i) {
      const Homography motion = GroundFromFrameAt(track, i - 1, geometry)->Inverse() * *GroundFromFrameAt(track, i, geometry);
      Affine link = motion.LinearisedAt(geometry.middle());
      const double angle = 90.0 * quarters * kRad;
      Eigen::Matrix2d turn;
      turn << std::cos(angle), -std::sin(angle), std::sin(angle), std::cos(angle);
      link.linear = turn * link.linear * turn.transpose();
      const Eigen::Vector2d shift = turn * (motion * geometry.middle() - geometry.middle());
      link.offset = geometry.middle() + shift - link.linear * geometry.middle();
      links.push_back({static_cast<double>(i), link});
    }
    const auto found = MeasureTurn(track, links, geometry);
    ASSERT_TRUE(found.has_value()) << quarters;
    EXPECT_EQ(found->quarter_turns, quarters);
    EXPECT_EQ(found->pairs, 5);
  }
}

}  // namespace
}  // namespace trem
