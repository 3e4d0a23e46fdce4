// Goal: the audit finds the convention under which a source's redundant fields follow from its pose, and refuses, with the reason, what
// follows under none. Method: records made here from a known camera under every convention, by an independent projection; damaged on
// purpose.
#include "worker/telemetry/telemetry_audit.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

#include "mosaic/geometry/camera.h"
#include "mosaic/raster/crs.h"

namespace trem {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

constexpr double kRad = std::numbers::pi / 180.0;

struct Flight {
  AzimuthReading azimuth = AzimuthReading::kRelative;
  NorthReading north = NorthReading::kTrue;
  double sign = 1.0;  // Of the stated elevation angle.
  double ground_m = 120.0;
};

// A camera on its way along a heading of 70 degrees with some pitch and roll, looking to the right and down.
std::vector<TelemetryRecord> Fly(const Flight& flight) {
  const UtmFrame map = UtmFrame::ForPoint(38.25, -77.36).value();
  const Eigen::Vector2d start = map.Forward(38.25, -77.36).value();
  const double scale = map.ScaleFactor(38.25, -77.36).value();
  std::vector<TelemetryRecord> records;
  for (int i = 0; i < 40; ++i) {
    TelemetryRecord r;
    r.time_s = 0.1 * i;
    const Eigen::Vector3d position(8.0 * i, 3.0 * i, 1200.0 + i);
    const Eigen::Vector2d at = map.Inverse(start + scale * position.head<2>()).value();
    r.sensor = GeoPoint{at.x(), at.y()};
    r.altitude_msl_m = position.z();
    r.platform_heading_deg = 70.0 + 0.2 * i;
    r.platform_pitch_deg = 3.0;
    r.platform_roll_deg = -6.0 + 0.1 * i;
    r.sensor_azimuth_deg = 95.0 - 0.3 * i;
    r.sensor_elevation_deg = -42.0 + 0.1 * i;
    r.hfov_deg = 2.0;
    r.vfov_deg = 1.5;
    // North-east-down axes from the sensor's, by the standard's angles.
    const auto turn = [](double heading, double pitch, double roll) {
      return Eigen::Matrix3d(
          (Eigen::AngleAxisd(heading * kRad, Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(pitch * kRad, Eigen::Vector3d::UnitY()) *
           Eigen::AngleAxisd(roll * kRad, Eigen::Vector3d::UnitX()))
              .toRotationMatrix());
    };
    Eigen::Matrix3d ned = turn(*r.sensor_azimuth_deg, *r.sensor_elevation_deg, 0.0);
    if (flight.azimuth == AzimuthReading::kRelative) ned = turn(*r.platform_heading_deg, 3.0, *r.platform_roll_deg) * ned;
    if (flight.azimuth == AzimuthReading::kRelativeLevel) ned = turn(*r.platform_heading_deg, 0.0, 0.0) * ned;
    const double convergence = flight.north == NorthReading::kTrue ? map.ConvergenceRad(at.x(), at.y()).value() : 0.0;
    const auto ground = [&](double right, double down) {
      const Eigen::Vector3d ray = ned * Eigen::Vector3d(1.0, right, down);
      const double bearing = std::atan2(ray.y(), ray.x()) - convergence;
      const double level = ray.head<2>().norm() / ray.z() * (position.z() - flight.ground_m);
      const Eigen::Vector2d x = position.head<2>() + level * Eigen::Vector2d(std::sin(bearing), std::cos(bearing));
      const Eigen::Vector2d place = map.Inverse(start + scale * x).value();
      return GeoPoint{place.x(), place.y()};
    };
    r.frame_centre = ground(0.0, 0.0);
    const double h = std::tan(1.0 * kRad);
    const double v = std::tan(0.75 * kRad);
    r.corners = {ground(-h, -v), ground(h, -v), ground(h, v), ground(-h, v)};
    const Eigen::Vector3d axis = ned.col(0);
    r.slant_range_m = (position.z() - flight.ground_m) / axis.z();
    r.centre_elevation_msl_m = flight.ground_m;
    r.sensor_elevation_deg = flight.sign * *r.sensor_elevation_deg;
    records.push_back(r);
  }
  return records;
}

TEST(TelemetryAudit, FindsTheConventionThatTheRedundantFieldsFollow) {
  for (const AzimuthReading azimuth : {AzimuthReading::kRelative, AzimuthReading::kRelativeLevel, AzimuthReading::kAbsolute}) {
    for (const NorthReading north : {NorthReading::kTrue, NorthReading::kGrid}) {
      for (const double sign : {1.0, -1.0}) {
        const TelemetryAudit audit = AuditTelemetry(Fly({azimuth, north, sign, 120.0}), {});
        SCOPED_TRACE(audit.explanation);
        ASSERT_EQ(audit.verdict, AuditVerdict::kFits);
        EXPECT_EQ(audit.convention.azimuth, azimuth);
        EXPECT_EQ(audit.convention.north, north);
        EXPECT_EQ(audit.convention.elevation, sign > 0 ? ElevationReading::kUp : ElevationReading::kDown);
        EXPECT_LT(audit.residual.centre_95_m, 0.2);
        EXPECT_LT(audit.residual.corners_95_m, 0.2);
        EXPECT_EQ(audit.poses.size(), 40U);
        EXPECT_EQ(audit.corners.size(), 40U);
        EXPECT_EQ(audit.ground_elevation_m, 120.0);
      }
    }
  }
}

TEST(TelemetryAudit, ItsPosesSeeTheStatedFrameCentres) {
  const std::vector<TelemetryRecord> records = Fly({AzimuthReading::kRelative, NorthReading::kTrue, 1.0, 120.0});
  const TelemetryAudit audit = AuditTelemetry(records, {});
  ASSERT_EQ(audit.poses.size(), records.size());
  const UtmFrame map = UtmFrame::ForPoint(38.25, -77.36).value();
  for (std::size_t i = 0; i < records.size(); i += 13) {
    const CameraSample& pose = audit.poses[i];
    const Eigen::Vector2d at = map.Forward(pose.latitude_deg, pose.longitude_deg).value();
    const double scale = map.ScaleFactor(pose.latitude_deg, pose.longitude_deg).value();
    CameraPose camera;
    camera.position_m << at / scale, pose.altitude_m;
    camera.yaw_rad = pose.yaw_deg * kRad - map.ConvergenceRad(pose.latitude_deg, pose.longitude_deg).value();
    camera.pitch_rad = pose.pitch_deg * kRad;
    camera.roll_rad = pose.roll_deg * kRad;
    const auto centre = IntersectGround(camera, {401, 301, 5000.0}, 120.0, {200.0, 150.0});
    ASSERT_TRUE(centre.has_value());
    const Eigen::Vector2d stated =
        map.Forward(records[i].frame_centre->latitude_deg, records[i].frame_centre->longitude_deg).value() / scale;
    EXPECT_LT((*centre - stated).norm(), 0.2);
  }
}

TEST(TelemetryAudit, TellsTheDatumOfTheGround) {
  std::vector<TelemetryRecord> records = Fly({});
  for (TelemetryRecord& r : records) {
    // Heights above the ellipsoid are consistent; those above the sea are off.
    r.altitude_hae_m = r.altitude_msl_m;
    r.centre_elevation_hae_m = r.centre_elevation_msl_m;
    r.centre_elevation_msl_m = *r.centre_elevation_msl_m + 33.0;
  }
  const TelemetryAudit audit = AuditTelemetry(records, {});
  ASSERT_EQ(audit.verdict, AuditVerdict::kFits) << audit.explanation;
  EXPECT_EQ(audit.convention.altitude, HeightReading::kEllipsoid);
  EXPECT_EQ(audit.ground_elevation_m, 120.0);
}

TEST(TelemetryAudit, RefusesWhatFitsNoConventionAndFallsBackOnTheCorners) {
  std::vector<TelemetryRecord> records = Fly({});
  for (std::size_t i = 0; i < records.size(); ++i) records[i].sensor_azimuth_deg = std::fmod(37.0 * static_cast<double>(i), 360.0);
  const TelemetryAudit audit = AuditTelemetry(records, {});
  EXPECT_EQ(audit.verdict, AuditVerdict::kCorners);
  EXPECT_TRUE(audit.poses.empty());
  EXPECT_EQ(audit.corners.size(), records.size());
  EXPECT_THAT(audit.explanation, HasSubstr("no convention fits"));
  for (TelemetryRecord& r : records) r.corners.reset();
  const TelemetryAudit bare = AuditTelemetry(records, {});
  EXPECT_EQ(bare.verdict, AuditVerdict::kRefused);
  EXPECT_THAT(bare.explanation, HasSubstr("no usable image corners"));
}

TEST(TelemetryAudit, NamesAFieldOfViewInRadians) {
  std::vector<TelemetryRecord> records = Fly({});
  for (TelemetryRecord& r : records) {
    r.hfov_deg = *r.hfov_deg * kRad;
    r.vfov_deg = *r.vfov_deg * kRad;
  }
  const TelemetryAudit audit = AuditTelemetry(records, {});
  EXPECT_EQ(audit.verdict, AuditVerdict::kCorners);
  EXPECT_THAT(audit.explanation, HasSubstr("looks like radians"));
}

TEST(TelemetryAudit, NamesExchangedLatitudeAndLongitude) {
  std::vector<TelemetryRecord> records = Fly({});
  for (TelemetryRecord& r : records) std::swap(r.sensor->latitude_deg, r.sensor->longitude_deg);
  const TelemetryAudit audit = AuditTelemetry(records, {});
  EXPECT_EQ(audit.verdict, AuditVerdict::kRefused);
  EXPECT_THAT(audit.explanation, HasSubstr("look exchanged"));
}

TEST(TelemetryAudit, NamesAReceiverWithoutAFix) {
  std::vector<TelemetryRecord> records = Fly({});
  for (TelemetryRecord& r : records) r.sensor = GeoPoint{0.0, 0.0};
  const TelemetryAudit audit = AuditTelemetry(records, {});
  EXPECT_EQ(audit.verdict, AuditVerdict::kCorners);
  ASSERT_FALSE(audit.doubts.empty());
  EXPECT_THAT(audit.doubts[0], HasSubstr("40 of 40 records place the sensor at latitude 0, longitude 0"));
  EXPECT_THAT(audit.explanation, HasSubstr("it lacks the sensor's position"));
}

TEST(TelemetryAudit, SaysWhatIsMissing) {
  std::vector<TelemetryRecord> records = Fly({});
  for (TelemetryRecord& r : records) {
    r.sensor_elevation_deg.reset();
    r.hfov_deg.reset();
    r.vfov_deg.reset();
    r.corners.reset();
  }
  const TelemetryAudit audit = AuditTelemetry(records, {});
  EXPECT_EQ(audit.verdict, AuditVerdict::kRefused);
  EXPECT_THAT(audit.explanation, HasSubstr("the sensor's azimuth and elevation, the field of view"));
}

TEST(TelemetryAudit, ACameraThatLooksAboveTheHorizonIsSaidSo) {
  std::vector<TelemetryRecord> records = Fly({});
  for (TelemetryRecord& r : records) {
    r.sensor_elevation_deg = 0.0;
    r.platform_pitch_deg = 0.0;
    r.platform_roll_deg = 0.0;
    r.corners.reset();
    r.frame_centre.reset();
  }
  EXPECT_THAT(AuditTelemetry(records, {}).explanation, HasSubstr("under no convention does the camera look down to the ground"));
}

TEST(TelemetryAudit, WithoutRedundantFieldsTheStandardsReadingIsTakenUnchecked) {
  std::vector<TelemetryRecord> records = Fly({});
  for (TelemetryRecord& r : records) {
    r.frame_centre.reset();
    r.corners.reset();
    r.slant_range_m.reset();
  }
  const TelemetryAudit audit = AuditTelemetry(records, {});
  EXPECT_EQ(audit.verdict, AuditVerdict::kUnchecked);
  EXPECT_EQ(audit.convention.azimuth, AzimuthReading::kRelative);
  EXPECT_EQ(audit.convention.north, NorthReading::kTrue);
  EXPECT_EQ(audit.poses.size(), records.size());
}

TEST(TelemetryAudit, CornersThatAreMirroredOrElsewhereAreLeftOut) {
  std::vector<TelemetryRecord> records = Fly({});
  std::swap((*records[3].corners)[0], (*records[3].corners)[1]);
  std::swap((*records[3].corners)[2], (*records[3].corners)[3]);
  for (GeoPoint& corner : *records[7].corners) corner.latitude_deg += 0.5;
  const TelemetryAudit audit = AuditTelemetry(records, {});
  EXPECT_EQ(audit.verdict, AuditVerdict::kFits);
  EXPECT_EQ(audit.corners.size(), records.size() - 2);
  ASSERT_EQ(audit.doubts.size(), 1U);
  EXPECT_THAT(audit.doubts[0], HasSubstr("2 of 40 records"));
}

}  // namespace
}  // namespace trem
