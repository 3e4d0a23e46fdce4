// Goal: rows find their frames by name or number, times and poses reach the frames (and those between them), and what has no partner is
// reported. Method: hand-made manifests and tables.
#include "worker/sortie/telemetry_match.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/support/paths.h"

namespace trem {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;

v1::SortieManifest Manifest(v1::SourceKind kind, const std::vector<std::string>& names, double interval_s) {
  v1::SortieManifest manifest;
  manifest.set_source_kind(kind);
  manifest.set_width_px(400);
  manifest.set_height_px(300);
  for (std::size_t i = 0; i < names.size(); ++i) {
    v1::ManifestFrame* frame = manifest.add_frames();
    frame->set_name(names[i]);
    frame->set_time_s(interval_s * static_cast<double>(i));
  }
  return manifest;
}

TelemetryRow Row(const std::string& frame, double yaw_deg, double latitude_deg = 50.0) {
  TelemetryRow row;
  row.frame = frame;
  row.pose = TelemetryPose{latitude_deg, 1.0, 100.0, yaw_deg, -90.0, 0.0, 30.0, std::nullopt};
  return row;
}

TelemetryTable Table(std::vector<TelemetryRow> rows) {
  TelemetryTable table;
  table.has_pose = true;
  table.rows = std::move(rows);
  return table;
}

std::vector<std::string> Codes(const v1::SortieManifest& manifest) {
  std::vector<std::string> codes;
  for (const v1::Note& note : manifest.notes()) codes.push_back(note.code());
  return codes;
}

TEST(AttachTelemetry, MatchesByFileNameWithAndWithoutExtension) {
  v1::SortieManifest manifest = Manifest(v1::IMAGE_SEQUENCE, {"a/f1.png", "a/f2.png", "a/f3.png"}, 0.1);
  ASSERT_TRUE(AttachTelemetry(Table({Row("f2", 20), Row("f1.png", 10), Row("a/f3.png", 30)}), "t.csv", {}, &manifest).ok());
  EXPECT_EQ(manifest.frames(0).pose().yaw_deg(), 10.0);
  EXPECT_EQ(manifest.frames(1).pose().yaw_deg(), 20.0);
  EXPECT_EQ(manifest.frames(2).pose().yaw_deg(), 30.0);
  EXPECT_EQ(manifest.telemetry_source(), v1::TELEMETRY_CSV);
}

TEST(AttachTelemetry, MatchesVideoByTheFrameNumberInTheFile) {
  v1::SortieManifest manifest = Manifest(v1::VIDEO, {"#5", "#6"}, 0.1);
  ASSERT_TRUE(AttachTelemetry(Table({Row("0", 1), Row("5", 2), Row("6", 3)}), "t.csv", {}, &manifest).ok());
  EXPECT_EQ(manifest.frames(0).pose().yaw_deg(), 2.0);
  EXPECT_EQ(manifest.frames(1).pose().yaw_deg(), 3.0);
  EXPECT_THAT(Codes(manifest), Contains("telemetry_rows_unused"));
}

TEST(AttachTelemetry, InterpolatesAcrossNorthBetweenMatchedFrames) {
  v1::SortieManifest manifest = Manifest(v1::IMAGE_SEQUENCE, {"0.png", "1.png", "2.png", "3.png", "4.png"}, 0.5);
  ASSERT_TRUE(AttachTelemetry(Table({Row("0.png", 358, 50.0), Row("2.png", 4, 50.0001)}), "t.csv", {}, &manifest).ok());
  EXPECT_NEAR(std::remainder(manifest.frames(1).pose().yaw_deg() - 1.0, 360.0), 0.0, 1e-9);
  EXPECT_NEAR(manifest.frames(1).pose().latitude_deg(), 50.00005, 1e-12);
  EXPECT_FALSE(manifest.frames(3).has_pose());
  EXPECT_THAT(Codes(manifest), Contains("poses_interpolated"));
  EXPECT_THAT(Codes(manifest), Contains("frames_without_row"));
}

TEST(AttachTelemetry, DoesNotInterpolateOverALongGap) {
  v1::SortieManifest manifest = Manifest(v1::IMAGE_SEQUENCE, {"0.png", "1.png", "2.png"}, 4.0);
  ASSERT_TRUE(AttachTelemetry(Table({Row("0.png", 0), Row("2.png", 4)}), "t.csv", {}, &manifest).ok());
  EXPECT_FALSE(manifest.frames(1).has_pose());
}

TEST(AttachTelemetry, GivesImagesTheTimesOfTheirRows) {
  v1::SortieManifest manifest = Manifest(v1::IMAGE_SEQUENCE, {"0.png", "1.png", "2.png", "3.png"}, 0.04);
  std::vector<TelemetryRow> rows = {Row("0.png", 0), Row("2.png", 4)};
  rows[0].time_s = 100.0;
  rows[1].time_s = 101.0;
  ASSERT_TRUE(AttachTelemetry(Table(rows), "t.csv", {}, &manifest).ok());
  EXPECT_NEAR(manifest.frames(1).time_s(), 100.5, 1e-12);
  EXPECT_NEAR(manifest.frames(3).time_s(), 101.5, 1e-12);
  // Seconds from the start are no date.
  EXPECT_FALSE(manifest.frames(0).has_utc_us());
}

TEST(AttachTelemetry, DatesFramesByRowsThatCountFrom1970) {
  std::vector<TelemetryRow> rows = {Row("0", 0), Row("2", 4)};
  rows[0].time_s = 1'245'257'585.25;
  rows[1].time_s = 1'245'257'586.25;
  v1::SortieManifest images = Manifest(v1::IMAGE_SEQUENCE, {"0.png", "1.png", "2.png"}, 0.04);
  ASSERT_TRUE(AttachTelemetry(Table(rows), "t.csv", {}, &images).ok());
  EXPECT_EQ(images.frames(0).utc_us(), 1'245'257'585'250'000);
  EXPECT_EQ(images.frames(1).utc_us(), 1'245'257'585'750'000);
  // A video keeps its own times.
  v1::SortieManifest video = Manifest(v1::VIDEO, {"#0", "#1", "#2"}, 0.04);
  ASSERT_TRUE(AttachTelemetry(Table(rows), "t.csv", {}, &video).ok());
  EXPECT_EQ(video.frames(2).utc_us(), 1'245'257'586'250'000);
  EXPECT_FALSE(video.frames(1).has_utc_us());
  // Images that tell themselves when they were taken, with times from the first on.
  rows[1].time_s = 1.0;
  rows[1].utc_us = 1'245'257'586'500'000;
  rows[0].time_s = 0.0;
  v1::SortieManifest photographs = Manifest(v1::IMAGE_SEQUENCE, {"0.png", "1.png", "2.png"}, 0.04);
  ASSERT_TRUE(AttachTelemetry(Table(rows), "t.csv", {}, &photographs).ok());
  EXPECT_EQ(photographs.frames(2).utc_us(), 1'245'257'586'500'000);
  EXPECT_FALSE(photographs.frames(0).has_utc_us());
}

TEST(AttachTelemetry, RefusesATableThatMatchesNoFrameWithAnExampleOfEach) {
  v1::SortieManifest manifest = Manifest(v1::IMAGE_SEQUENCE, {"img_1.png"}, 0.1);
  const Status status = AttachTelemetry(Table({Row("frame_1.png", 1)}), "t.csv", {}, &manifest);
  EXPECT_EQ(status.code(), StatusCode::kInvalidInput);
  EXPECT_THAT(status.message(), HasSubstr("'frame_1.png'"));
  EXPECT_THAT(status.message(), HasSubstr("'img_1.png'"));
}

TEST(AttachTelemetry, DerivesTheHorizontalFieldFromTheVerticalOne) {
  v1::SortieManifest manifest = Manifest(v1::IMAGE_SEQUENCE, {"0.png"}, 0.1);
  TelemetryRow row = Row("0.png", 0);
  row.pose->hfov_deg.reset();
  row.pose->vfov_deg = 2.0 * std::atan(0.3) * 180.0 / M_PI;
  ASSERT_TRUE(AttachTelemetry(Table({row}), "t.csv", {}, &manifest).ok());
  EXPECT_NEAR(manifest.frames(0).pose().hfov_deg(), 2.0 * std::atan(0.4) * 180.0 / M_PI, 1e-9);
}

TEST(AttachTelemetry, TakesTheGroundElevationFromSpecThenRowsThenZero) {
  v1::Telemetry spec;
  TelemetryRow row = Row("0.png", 0);
  v1::SortieManifest assumed = Manifest(v1::IMAGE_SEQUENCE, {"0.png"}, 0.1);
  ASSERT_TRUE(AttachTelemetry(Table({row}), "t.csv", spec, &assumed).ok());
  EXPECT_EQ(assumed.ground_elevation_m(), 0.0);
  EXPECT_THAT(Codes(assumed), Contains("ground_elevation_assumed"));
  row.ground_elevation_m = 40.0;
  v1::SortieManifest from_row = Manifest(v1::IMAGE_SEQUENCE, {"0.png"}, 0.1);
  ASSERT_TRUE(AttachTelemetry(Table({row}), "t.csv", spec, &from_row).ok());
  EXPECT_EQ(from_row.ground_elevation_m(), 40.0);
  spec.set_ground_elevation_m(150.0);
  v1::SortieManifest from_spec = Manifest(v1::IMAGE_SEQUENCE, {"0.png"}, 0.1);
  ASSERT_TRUE(AttachTelemetry(Table({row}), "t.csv", spec, &from_spec).ok());
  EXPECT_EQ(from_spec.ground_elevation_m(), 150.0);
  EXPECT_THAT(Codes(from_spec), Contains("camera_below_ground"));
}

TEST(AttachTelemetry, ReportsRepeatedRowsAndJumps) {
  v1::SortieManifest manifest = Manifest(v1::IMAGE_SEQUENCE, {"0.png", "1.png"}, 0.1);
  ASSERT_TRUE(AttachTelemetry(Table({Row("0.png", 0), Row("0.png", 9), Row("1.png", 0, 50.1)}), "t.csv", {}, &manifest).ok());
  EXPECT_EQ(manifest.frames(0).pose().yaw_deg(), 0.0);
  EXPECT_THAT(Codes(manifest), Contains("telemetry_rows_repeated"));
  EXPECT_THAT(Codes(manifest), Contains("position_jumps"));
}

TEST(FindTelemetryCsv, LooksInTheFolderAndItsParent) {
  const testing::TempDir folder;
  std::filesystem::create_directories(folder / "frames");
  v1::Sortie sortie;
  sortie.mutable_source()->set_path((folder / "frames").string());
  EXPECT_FALSE(FindTelemetryCsv(sortie).has_value());
  testing::WriteFileContents(folder / "telemetry.csv", "x");
  EXPECT_EQ(FindTelemetryCsv(sortie), (folder / "telemetry.csv").string());
  sortie.mutable_source()->set_path((folder / "frames").string() + "/");
  EXPECT_EQ(FindTelemetryCsv(sortie), (folder / "telemetry.csv").string());
  testing::WriteFileContents(folder / "frames/telemetry.csv", "x");
  EXPECT_EQ(FindTelemetryCsv(sortie), (folder / "frames/telemetry.csv").string());
  sortie.mutable_telemetry()->set_ignore(true);
  EXPECT_FALSE(FindTelemetryCsv(sortie).has_value());
}

}  // namespace
}  // namespace trem
