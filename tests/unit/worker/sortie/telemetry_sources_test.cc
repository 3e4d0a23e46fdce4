// Goal: telemetry is found where it lies, in the documented order, becomes poses of the right frames, and what is unusable is said. Method:
// small sorties written here with subtitles, tracks and elevation models; the shared photographs where they are present.
#include "worker/sortie/telemetry_sources.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <iostream>

#include "mosaic/raster/crs.h"
#include "mosaic/raster/geotiff.h"
#include "proto/codec/convert.h"
#include "tests/support/paths.h"
#include "tests/unit/worker/sortie/test_video.h"
#include "worker/sortie/ingest.h"
#include "worker/sortie/sortie_ground.h"

namespace trem {
namespace {

using ::testing::HasSubstr;
using testing::TexturedFrame;

constexpr int kWidth = 160;
constexpr int kHeight = 120;
constexpr int kFrames = 24;

class TelemetrySources : public ::testing::Test {
 protected:
  void SetUp() override {
    // As the subtitles say: 1.11 m a frame northwards, looking down from 100 m with 73.7 degrees over 160 px, up in the picture 20 degrees
    // east of north.
    Film(-0.406, -1.115);
    sortie_.mutable_source()->set_path(Video().string());
  }

  // A video of which each frame shows the ground `dx`, `dy` pixels further.
  void Film(double dx, double dy) const {
    std::vector<Image<float>> frames;
    for (int i = 0; i < kFrames; ++i) frames.push_back(TexturedFrame(kWidth, kHeight, 200.0 + dx * i, 200.0 + dy * i, 5));
    testing::WriteVideo(Video(), frames, {});
  }

  std::filesystem::path Video() const { return dir_ / "flight.avi"; }
  std::string NoteOf(const v1::SortieManifest& manifest, const std::string& code) const {
    for (const v1::Note& note : manifest.notes()) {
      if (note.code() == code) return note.message();
    }
    return "";
  }
  // A subtitle a frame, northwards, looking down.
  std::string Srt(double latitude_deg = 46.0) const {
    std::string text;
    for (int i = 0; i < kFrames; ++i) {
      char line[400];
      std::snprintf(line, sizeof(line),
                    "%d\n00:00:%02d,%d00 --> 00:00:59,000\n[latitude: %.7f] [longitude: 7.5] [rel_alt: 100.0 abs_alt: 700.0] [gb_yaw: 20.0 "
                    "gb_pitch: -90.0 "
                    "gb_roll: 0.0] [focal_len: 24.0]\n\n",
                    i + 1, i / 10, i % 10, latitude_deg + 1e-5 * i);
      text += line;
    }
    return text;
  }
  // A plane of 600 m, 20 x 20 km around 46 N 7.5 E, in degrees.
  std::string Dem(double level_m) const {
    FloatRaster raster;
    Image<float> z(200, 200, static_cast<float>(level_m));
    raster.bands.push_back({"elevation", z});
    MosaicGrid grid;
    grid.crs_wkt = CrsWkt("EPSG:4326").value();
    grid.origin_x = 7.4;
    grid.origin_y = 46.1;
    grid.gsd = 0.001;
    grid.width = z.width();
    grid.height = z.height();
    raster.grid = grid;
    EXPECT_TRUE(WriteFloatRaster(dir_ / "dem.tif", raster).ok());
    return (dir_ / "dem.tif").string();
  }

  testing::TempDir dir_;
  v1::Sortie sortie_;
};

TEST_F(TelemetrySources, SubtitlesBesideAVideoBecomePosesOfItsFrames) {
  testing::WriteFileContents(dir_ / "flight.srt", Srt());
  sortie_.mutable_telemetry()->set_attitude_sigma_deg(0.5);  // 1 px: the motion of such small frames is not measured well.
  const auto manifest = IngestSortie(sortie_, {});
  ASSERT_TRUE(manifest.ok()) << manifest.status().message();
  EXPECT_EQ(manifest->telemetry_source(), v1::TELEMETRY_SRT);
  EXPECT_THAT(manifest->telemetry_summary(), HasSubstr("unchecked"));
  ASSERT_EQ(manifest->frames_size(), kFrames);
  EXPECT_NEAR(manifest->frames(12).pose().latitude_deg(), 46.0 + 12e-5, 1e-9);
  EXPECT_EQ(NoteOf(*manifest, "telemetry_wanders"), "");
  EXPECT_NEAR(manifest->frames(12).pose().pitch_deg(), -90.0, 1e-6);
  EXPECT_NEAR(manifest->ground_elevation_m(), 600.0, 1e-6);
  EXPECT_FALSE(NoteOf(*manifest, "time_offset_not_estimated").empty());
}

TEST_F(TelemetrySources, ATimeOffsetThatIsGivenMovesThePoses) {
  testing::WriteFileContents(dir_ / "flight.srt", Srt());
  sortie_.mutable_telemetry()->set_time_offset_s(0.5);
  const auto manifest = IngestSortie(sortie_, {});
  ASSERT_TRUE(manifest.ok());
  EXPECT_NEAR(manifest->frames(10).pose().latitude_deg(), 46.0 + 15e-5, 1e-9);
}

TEST_F(TelemetrySources, ATelemetryCsvComesBeforeSubtitles) {
  testing::WriteFileContents(dir_ / "flight.srt", Srt());
  testing::WriteFileContents(dir_ / "telemetry.csv",
                             "frame,latitude_deg,longitude_deg,altitude_m,yaw_deg,pitch_deg,roll_deg,hfov_deg\n0,10,20,500,0,-90,0,30\n");
  const auto manifest = IngestSortie(sortie_, {});
  ASSERT_TRUE(manifest.ok());
  EXPECT_EQ(manifest->telemetry_source(), v1::TELEMETRY_CSV);
}

TEST_F(TelemetrySources, AGpxTrackNeedsAnAttitudeAndAFieldOfViewAndSaysSo) {
  testing::WriteFileContents(
      dir_ / "walk.gpx",
      "<gpx><trk><trkseg><trkpt lat=\"46\" lon=\"7.5\"><ele>700</ele><time>2024-05-17T10:20:30Z</time></trkpt>"
      "<trkpt lat=\"46.001\" lon=\"7.5\"><ele>700</ele><time>2024-05-17T10:20:34Z</time></trkpt></trkseg></trk></gpx>");
  sortie_.mutable_telemetry()->set_path((dir_ / "walk.gpx").string());
  Film(0.0, -3.85);  // 2.78 m a frame, from 100 m with 60 degrees.
  const auto bare = IngestSortie(sortie_, {});
  ASSERT_TRUE(bare.ok()) << bare.status().message();
  EXPECT_EQ(bare->telemetry_source(), v1::TELEMETRY_NONE);
  EXPECT_THAT(NoteOf(*bare, "telemetry_refused"), HasSubstr("the sensor's azimuth and elevation, the field of view"));
  sortie_.mutable_telemetry()->set_pitch_deg(-90.0);
  sortie_.mutable_telemetry()->set_hfov_deg(60.0);
  sortie_.mutable_telemetry()->set_ground_elevation_m(600.0);
  const auto manifest = IngestSortie(sortie_, {});
  ASSERT_TRUE(manifest.ok());
  EXPECT_EQ(manifest->telemetry_source(), v1::TELEMETRY_GPX);
  EXPECT_NEAR(manifest->frames(20).pose().latitude_deg(), 46.0005, 1e-9);
  EXPECT_NEAR(manifest->frames(20).pose().yaw_deg(), 0.0, 1e-6);
  EXPECT_EQ(manifest->frames(20).pose().hfov_deg(), 60.0);
}

TEST_F(TelemetrySources, AnElevationModelTellsTheGroundThatIsSeen) {
  testing::WriteFileContents(dir_ / "flight.srt", Srt());
  sortie_.mutable_telemetry()->set_dem_path(Dem(580.0));
  const auto manifest = IngestSortie(sortie_, {});
  ASSERT_TRUE(manifest.ok()) << manifest.status().message();
  EXPECT_NEAR(manifest->ground_elevation_m(), 580.0, 1e-3);
  ASSERT_TRUE(manifest->has_ground());
  const auto ground = GroundOfManifest(*manifest);
  ASSERT_TRUE(ground.ok() && ground->has_value());
  EXPECT_NEAR((*ground)->ElevationAt({7.5, 46.0001}).value_or(0.0), 580.0, 1e-3);
  EXPECT_THAT(NoteOf(*manifest, "dem"), HasSubstr("580.0 m in the median"));
}

TEST_F(TelemetrySources, AnElevationModelThatDoesNotCoverOrLiesAboveTheCameraIsRefused) {
  testing::WriteFileContents(dir_ / "flight.srt", Srt(10.0));
  sortie_.mutable_telemetry()->set_dem_path(Dem(580.0));
  EXPECT_THAT(IngestSortie(sortie_, {}).status().message(), HasSubstr("has no elevation within longitude"));
  testing::WriteFileContents(dir_ / "flight.srt", Srt());
  sortie_.mutable_telemetry()->set_dem_path(Dem(2000.0));
  const auto above = IngestSortie(sortie_, {});
  if (above.ok()) {
    EXPECT_THAT(NoteOf(*above, "telemetry_refused") + NoteOf(*above, "dem_unused"),
                HasSubstr("above the horizon, or stands below the ground"));
  } else {
    EXPECT_THAT(above.status().message(), HasSubstr("no ray of any frame meets it"));
  }
}

TEST_F(TelemetrySources, SubtitlesOfAFilmAreLeftWithAWarning) {
  testing::WriteFileContents(dir_ / "flight.srt", "1\n00:00:01,000 --> 00:00:02,000\nGood evening.\n");
  const auto manifest = IngestSortie(sortie_, {});
  ASSERT_TRUE(manifest.ok());
  EXPECT_EQ(manifest->telemetry_source(), v1::TELEMETRY_NONE);
  EXPECT_THAT(NoteOf(*manifest, "telemetry_refused"), HasSubstr("none of its 1 subtitles states a place"));
}

// The photographs look straight down, were taken 13.5 m apart, and were turned by a viewer: what the images' motion says about scale and
// heading has to agree with what telemetry says, within the receiver's error from picture to picture (1 m) and 2 % of the focal length.
TEST(SharedPhotographs, ArePlacedWithTheRightScaleHeadingAndOverlap) {
  const auto data = testing::TestDataDir();
  if (!data.has_value()) GTEST_SKIP() << "no sample data (../shared/data or TREM_TEST_DATA)";
  v1::Sortie sortie;
  sortie.mutable_source()->set_path((*data / "exif").string());
  const auto manifest = IngestSortie(sortie, {});
  ASSERT_TRUE(manifest.ok()) << manifest.status().message();
  EXPECT_EQ(manifest->telemetry_source(), v1::TELEMETRY_EXIF);
  ASSERT_EQ(manifest->frames_size(), 3);
  EXPECT_NEAR(manifest->frames(2).time_s() - manifest->frames(0).time_s(), 14.0, 1e-6);
  EXPECT_THAT(manifest->notes(), ::testing::Contains(::testing::Property(&v1::Note::code, "pictures_turned")));
  const double rad = M_PI / 180.0;
  for (int i = 1; i < 3; ++i) {
    const v1::ManifestFrame& frame = manifest->frames(i);
    ASSERT_TRUE(frame.has_pose());
    ASSERT_GT(frame.motion_correlation(), 0.0);
    const Affine motion = AffineFromProto(frame.previous_from_current(), "motion").value();
    const Eigen::Vector2d middle(1999.5, 1124.5);
    const Eigen::Vector2d seen_px = motion * middle - middle;
    const v1::Pose& a = manifest->frames(i - 1).pose();
    const v1::Pose& b = frame.pose();
    // Of the axis' foot: the gimbal is 0.1 degrees off the nadir.
    const double gsd_m =
        2.0 * (b.altitude_m() - manifest->ground_elevation_m()) * std::tan(0.5 * b.hfov_deg() * rad) / manifest->width_px();
    const double east_m = (b.longitude_deg() - a.longitude_deg()) * 111320.0 * std::cos(b.latitude_deg() * rad);
    const double north_m = (b.latitude_deg() - a.latitude_deg()) * 111132.0;
    // Straight down, the image's up is where yaw and roll together point.
    const double yaw = (a.yaw_deg() + a.roll_deg()) * rad;
    const Eigen::Vector2d stated_m(east_m * std::cos(yaw) - north_m * std::sin(yaw), -(east_m * std::sin(yaw) + north_m * std::cos(yaw)));
    const Eigen::Vector2d seen_m = seen_px * gsd_m;
    const double scale = seen_m.norm() / stated_m.norm();
    const double turn_deg = (std::atan2(seen_m.y(), seen_m.x()) - std::atan2(stated_m.y(), stated_m.x())) / rad;
    const double overlap = (1.0 - std::abs(seen_px.x()) / manifest->width_px()) * (1.0 - std::abs(seen_px.y()) / manifest->height_px());
    const double stated_overlap =
        (1.0 - std::abs(stated_m.x()) / gsd_m / manifest->width_px()) * (1.0 - std::abs(stated_m.y()) / gsd_m / manifest->height_px());
    std::cout << frame.name() << ": moved " << seen_m.norm() << " m by the image, " << stated_m.norm() << " m by telemetry (ratio " << scale
              << "), direction differs by " << std::remainder(turn_deg, 360.0) << " deg, overlap " << overlap << " and " << stated_overlap
              << "\n";
    EXPECT_NEAR(scale, 1.0, 1.0 / stated_m.norm() + 0.02);
    EXPECT_NEAR(std::remainder(turn_deg, 360.0), 0.0, 5.0);
    EXPECT_NEAR(overlap, stated_overlap, 0.05);
  }
}

}  // namespace
}  // namespace trem
