// Goal: subtitles, tracks and times are read as their makers write them, and what is malformed is named with its line or point. Method:
// short texts in each dialect, and damaged ones.
#include "worker/telemetry/track_files.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "worker/telemetry/text_scan.h"

namespace trem {
namespace {

using ::testing::HasSubstr;

constexpr double kAspect = 16.0 / 9.0;

TEST(TextScan, TimesAreUtcWhateverTheirZoneAndFraction) {
  EXPECT_EQ(ParseTimeUtc("1970-01-02T00:00:01Z"), 86'401'000'000);
  EXPECT_EQ(ParseTimeUtc("2019-04-18 14:34:10,567"), *ParseTimeUtc("2019-04-18T14:34:10Z") + 567'000);
  EXPECT_EQ(ParseTimeUtc("2019-04-18T16:34:10.5+02:00"), *ParseTimeUtc("2019-04-18T14:34:10Z") + 500'000);
  EXPECT_EQ(ParseTimeUtc("2019:04:18 14:34:10"), ParseTimeUtc("2019-04-18T14:34:10Z"));
  for (const char* bad :
       {"", "2019-04-31T00:00:00Z", "2019-04-18", "2019-04-18T25:00:00Z", "2019-04-18T14:34:10X", "18.04.2019 14:34:10"}) {
    EXPECT_FALSE(ParseTimeUtc(bad).has_value()) << bad;
  }
}

TEST(TextScan, FieldsOfViewOfEquivalentFocalLengths) {
  // 36 mm wide film behind 18 mm: 90 degrees; a 4:3 sensor of the same diagonal is 34.61 mm wide.
  EXPECT_NEAR(HfovOfFocal35(18.0, 1.5), 90.0, 1e-3);
  EXPECT_NEAR(HfovOfFocal35(20.0, 4.0 / 3.0), 81.74, 0.01);
  EXPECT_NEAR(HfovOfFocal35(20.0, 16.0 / 9.0), 81.74, 0.01);
}

TEST(DjiSrt, ReadsTheBracketedDialect) {
  const std::string text =
      "1\r\n00:00:00,000 --> 00:00:00,033\r\n<font size=\"28\">SrtCnt : 1, DiffTime : 33ms\r\n2019-04-18 14:34:10,567,123\r\n"
      "[iso : 100] [focal_len : 240] [latitude: 46.8427] [longitude: -91.9938] [rel_alt: 40.100 abs_alt: 198.609] "
      "[gb_yaw: -132.0 gb_pitch: -89.9 gb_roll: 0.5] </font>\r\n\r\n"
      "2\n00:00:01,033 --> 00:00:01,066\n[latitude : 46.8428] [longtitude : -91.9939] [altitude: 41.0]\n";
  const auto records = ParseDjiSrt(text, "a.srt", kAspect);
  ASSERT_TRUE(records.ok()) << records.status().message();
  ASSERT_EQ(records->size(), 2U);
  const TelemetryRecord& first = (*records)[0];
  EXPECT_EQ(first.sensor->latitude_deg, 46.8427);
  EXPECT_EQ(first.sensor->longitude_deg, -91.9938);
  EXPECT_EQ(first.altitude_msl_m, 198.609);
  EXPECT_NEAR(*first.centre_elevation_msl_m, 158.509, 1e-9);
  EXPECT_EQ(first.sensor_elevation_deg, -89.9);
  EXPECT_EQ(first.sensor_azimuth_deg, -132.0);
  EXPECT_NEAR(*first.hfov_deg, HfovOfFocal35(24.0, kAspect), 1e-9);
  EXPECT_NEAR((*records)[1].time_s, 1.033, 1e-12);
  EXPECT_EQ((*records)[1].altitude_msl_m, 41.0);
  EXPECT_EQ((*records)[1].centre_elevation_msl_m, 0.0);
}

TEST(DjiSrt, ReadsTheOldDialect) {
  const auto records = ParseDjiSrt(
      "1\n00:00:01,000 --> 00:00:02,000\nHOME(-122.13,37.5) 2016.1.1\nGPS(-122.1309,37.5054,17) BAROMETER:7.2\n", "b.srt", kAspect);
  ASSERT_TRUE(records.ok()) << records.status().message();
  EXPECT_EQ((*records)[0].sensor->latitude_deg, 37.5054);
  EXPECT_EQ((*records)[0].sensor->longitude_deg, -122.1309);
  EXPECT_EQ((*records)[0].altitude_msl_m, 7.2);
}

TEST(DjiSrt, NamesWhatIsMalformedAndWhatHasNoPlace) {
  EXPECT_THAT(ParseDjiSrt("1\n00:00 --> x\n", "a.srt", kAspect).status().message(), HasSubstr("a.srt:2: found '00:00 --> x'"));
  EXPECT_THAT(ParseDjiSrt("1\n00:00:01,000 --> 00:00:02,000\nHello\n", "a.srt", kAspect).status().message(),
              HasSubstr("none of its 1 subtitles states a place"));
  EXPECT_FALSE(ParseDjiSrt("1\n00:00:01,000 --> 00:00:02,000\n[latitude: 146.0] [longitude: 3.0]\n", "a.srt", kAspect).ok());
}

std::string Gpx(const std::string& points) {
  return "<?xml version=\"1.0\"?><gpx version=\"1.1\" xmlns=\"http://www.topografix.com/GPX/1/1\"><trk><trkseg>" + points +
         "</trkseg></trk></gpx>";
}

TEST(Gpx, ReadsPointsInTheOrderOfTime) {
  const auto records = ParseGpx(Gpx("<trkpt lat=\"46.1\" lon=\"7.2\"><ele>900.5</ele><time>2024-05-17T10:20:32Z</time></trkpt>"
                                    "<trkpt lat=\"46.0\" lon=\"7.1\"><ele>900</ele><time>2024-05-17T10:20:30.5Z</time></trkpt>"
                                    "<trkpt lat=\"46.0\" lon=\"7.1\"><ele>1</ele></trkpt>"),
                                "t.gpx");
  ASSERT_TRUE(records.ok()) << records.status().message();
  ASSERT_EQ(records->size(), 2U);
  EXPECT_EQ((*records)[0].sensor->latitude_deg, 46.0);
  EXPECT_EQ((*records)[0].time_s, 0.0);
  EXPECT_NEAR((*records)[1].time_s, 1.5, 1e-9);
  EXPECT_EQ((*records)[1].altitude_msl_m, 900.5);
}

TEST(Gpx, NamesWhatIsMalformed) {
  EXPECT_THAT(ParseGpx("<gpx><trk>", "t.gpx").status().message(), HasSubstr("t.gpx: byte"));
  EXPECT_THAT(ParseGpx("<kml/>", "t.gpx").status().message(), HasSubstr("has no gpx element"));
  EXPECT_THAT(ParseGpx(Gpx("<trkpt lat=\"x\" lon=\"7\"/>"), "t.gpx").status().message(), HasSubstr("track point 1: found lat 'x'"));
  EXPECT_THAT(ParseGpx(Gpx("<trkpt lat=\"1\" lon=\"7\"><time>noon</time></trkpt>"), "t.gpx").status().message(),
              HasSubstr("found time 'noon'"));
  EXPECT_THAT(ParseGpx(Gpx("<trkpt lat=\"1\" lon=\"7\"/>"), "t.gpx").status().message(), HasSubstr("0 of its 1 track points have a time"));
}

TEST(FixedPointing, TheCourseServesAsAzimuthAndStatedAnglesStay) {
  std::vector<TelemetryRecord> records(5);
  for (std::size_t i = 0; i < records.size(); ++i) {
    records[i].sensor = GeoPoint{46.0, 7.0 + 1e-4 * static_cast<double>(i)};  // East by 7.7 m a record.
    records[i].time_s = static_cast<double>(i);
  }
  records[2].sensor_azimuth_deg = 12.0;
  records[3].vfov_deg = 3.0;
  std::vector<TelemetryRecord> without = records;
  FixedPointing fixed;
  fixed.hfov_deg = 60.0;
  fixed.pitch_deg = -90.0;
  FillPointing(fixed, &records);
  EXPECT_NEAR(*records[0].sensor_azimuth_deg, 90.0, 1e-6);
  EXPECT_NEAR(*records[4].sensor_azimuth_deg, 90.0, 1e-6);
  EXPECT_EQ(records[2].sensor_azimuth_deg, 12.0);
  EXPECT_EQ(records[3].hfov_deg, 60.0);
  EXPECT_FALSE(records[3].vfov_deg.has_value());
  // Nothing is invented without an elevation angle.
  FillPointing({}, &without);
  EXPECT_FALSE(without[0].HasPointing());
}

}  // namespace
}  // namespace trem
