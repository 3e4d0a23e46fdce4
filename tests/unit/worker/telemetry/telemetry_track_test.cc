// Goal: poses at the frames' times, and an uncertainty that covers what interpolation misses. Method: samples of smooth curves against
// the curves; gaps and ends.
#include "worker/telemetry/telemetry_track.h"

#include <gtest/gtest.h>

#include <cmath>

namespace trem {
namespace {

CameraSample Curve(double t) {
  CameraSample sample;
  sample.time_s = t;
  sample.latitude_deg = 50.0 + 1e-4 * std::cos(0.5 * t);
  sample.longitude_deg = 10.0 + 1e-4 * std::sin(0.5 * t);
  sample.altitude_m = 800.0 + 2.0 * t;
  sample.yaw_deg = std::remainder(178.0 + 3.0 * t, 360.0);
  sample.pitch_deg = -60.0 + std::sin(t);
  sample.hfov_deg = 10.0;
  return sample;
}

std::vector<CameraSample> Samples(double interval_s, int count) {
  std::vector<CameraSample> samples;
  for (int i = 0; i < count; ++i) samples.push_back(Curve(interval_s * i));
  return samples;
}

double ErrorM(const CameraSample& a, const CameraSample& b) {
  const double east = (a.longitude_deg - b.longitude_deg) * 111320.0 * std::cos(50.0 * M_PI / 180.0);
  return std::hypot(east, (a.latitude_deg - b.latitude_deg) * 111320.0, a.altitude_m - b.altitude_m);
}

TEST(TelemetryTrack, FollowsASmoothCurveAndItsUncertaintyCoversTheError) {
  const TelemetryTrack track(Samples(0.5, 60));
  double error2 = 0.0;
  double sigma2 = 0.0;
  int count = 0;
  for (double t = 0.13; t < 29.0; t += 0.31, ++count) {
    const auto pose = track.At(t);
    ASSERT_TRUE(pose.has_value());
    const CameraSample truth = Curve(t);
    EXPECT_NEAR(std::remainder(pose->camera.yaw_deg - truth.yaw_deg, 360.0), 0.0, 0.05);
    EXPECT_NEAR(pose->camera.pitch_deg, truth.pitch_deg, 0.05);
    error2 += std::pow(ErrorM(pose->camera, truth), 2);
    sigma2 += std::pow(pose->uncertainty.position_m, 2);
  }
  const double ratio = std::sqrt(error2 / sigma2);
  EXPECT_GT(ratio, 0.5);
  EXPECT_LT(ratio, 1.5);
}

TEST(TelemetryTrack, ASampleItselfIsExactAndNotInterpolated) {
  const TelemetryTrack track(Samples(0.5, 10));
  const auto pose = track.At(2.0);
  ASSERT_TRUE(pose.has_value());
  EXPECT_FALSE(pose->interpolated);
  EXPECT_NEAR(pose->camera.yaw_deg, Curve(2.0).yaw_deg, 1e-9);
  EXPECT_EQ(pose->uncertainty.position_m, 0.0);
}

TEST(TelemetryTrack, NothingIsInventedInGapsAndBeyondTheEnds) {
  std::vector<CameraSample> samples = Samples(0.5, 4);
  samples.push_back(Curve(20.0));
  const TelemetryTrack track(samples);
  EXPECT_TRUE(track.At(1.4).has_value());
  EXPECT_FALSE(track.At(10.0).has_value());
  EXPECT_TRUE(track.At(20.2).has_value());
  EXPECT_FALSE(track.At(20.3).has_value());
  EXPECT_FALSE(track.At(-0.3).has_value());
  EXPECT_TRUE(track.At(-0.2).has_value());
  EXPECT_FALSE(TelemetryTrack({}).At(0.0).has_value());
}

TEST(TelemetryTrack, RotationsNearTheNadirAreInterpolatedAsRotations) {
  CameraSample a = Curve(0.0);
  CameraSample b = Curve(1.0);
  a.yaw_deg = 10.0;
  a.pitch_deg = -89.5;
  a.roll_deg = 0.0;
  // Half a degree to the other side of the nadir: the yaw of the axis flips, the image hardly turns.
  b.yaw_deg = -170.0;
  b.pitch_deg = -89.5;
  b.roll_deg = 180.0;
  const auto pose = TelemetryTrack({a, b}).At(0.5);
  ASSERT_TRUE(pose.has_value());
  EXPECT_NEAR(pose->camera.pitch_deg, -90.0, 1e-6);
}

}  // namespace
}  // namespace trem
