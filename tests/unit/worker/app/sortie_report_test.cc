// Goal: the report of `trem inspect` states what the manifest holds, above all where the frames lie on the ground. Method: hand-made
// manifests with poses whose footprint is known by hand.
#include "worker/app/sortie_report.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

namespace trem {
namespace {

using ::testing::HasSubstr;

v1::SortieManifest TwoFrames() {
  v1::SortieManifest manifest;
  manifest.set_source_path("/data/run");
  manifest.set_source_kind(v1::IMAGE_SEQUENCE);
  manifest.set_width_px(400);
  manifest.set_height_px(300);
  manifest.mutable_valid_roi()->set_x1(400);
  manifest.mutable_valid_roi()->set_y1(300);
  manifest.set_grey_max(255.0);
  manifest.set_grey_scale(1.0);
  manifest.set_noise_sigma(2.0);
  for (int i = 0; i < 3; ++i) {
    v1::ManifestFrame* frame = manifest.add_frames();
    frame->set_name("f" + std::to_string(i));
    frame->set_time_s(0.1 * i);
  }
  manifest.mutable_frames(1)->set_state(v1::FRAME_UNREADABLE);
  for (const double number : {1.0, 0.0, 3.0, 0.0, 1.0, 4.0}) manifest.mutable_frames(2)->add_previous_from_current(number);
  manifest.mutable_frames(2)->set_motion_correlation(0.9);
  manifest.add_spans()->set_end(3);
  return manifest;
}

v1::Pose NadirPose() {
  v1::Pose pose;
  pose.set_latitude_deg(60.0);
  pose.set_longitude_deg(10.0);
  pose.set_altitude_m(220.0);
  pose.set_pitch_deg(-90.0);
  pose.set_hfov_deg(2.0 * std::atan(0.2) * 180.0 / M_PI);
  return pose;
}

TEST(SortieReport, CountsFramesStatesAndMotion) {
  const SortieReport report = ReportOn(TwoFrames());
  EXPECT_EQ(report.frame_count, 3);
  EXPECT_EQ(report.usable_count, 2);
  EXPECT_EQ(report.unreadable_count, 1);
  EXPECT_EQ(report.link_count, 1);
  EXPECT_EQ(report.failed_link_count, 0);
  EXPECT_NEAR(report.motion_median_px, 5.0, 1e-9);
  EXPECT_NEAR(report.frame_rate_hz, 10.0, 1e-9);
  EXPECT_FALSE(report.footprint.has_value());
}

TEST(SortieReport, FindsTheGroundOfANadirPose) {
  v1::SortieManifest manifest = TwoFrames();
  manifest.set_ground_elevation_m(20.0);
  manifest.set_telemetry_source(v1::TELEMETRY_CSV);
  *manifest.mutable_frames(0)->mutable_pose() = NadirPose();
  const SortieReport report = ReportOn(manifest);
  ASSERT_TRUE(report.footprint.has_value());
  // 200 m above ground, half width 0.2 * 200 = 40 m, half height 30 m.
  EXPECT_NEAR(report.footprint->gsd_m, 0.2, 1e-9);
  EXPECT_NEAR((report.footprint->north_deg - report.footprint->south_deg) * 111320.0, 60.0, 0.01);
  EXPECT_NEAR((report.footprint->east_deg - report.footprint->west_deg) * 111320.0 * 0.5, 80.0, 0.01);
  EXPECT_NEAR(0.5 * (report.footprint->north_deg + report.footprint->south_deg), 60.0, 1e-9);
}

TEST(SortieReport, LeavesFramesWithTheHorizonOutOfTheFootprint) {
  v1::SortieManifest manifest = TwoFrames();
  *manifest.mutable_frames(0)->mutable_pose() = NadirPose();
  manifest.mutable_frames(0)->mutable_pose()->set_pitch_deg(-3.0);
  EXPECT_FALSE(ReportOn(manifest).footprint.has_value());
  *manifest.mutable_frames(2)->mutable_pose() = NadirPose();
  const SortieReport report = ReportOn(manifest);
  ASSERT_TRUE(report.footprint.has_value());
  EXPECT_EQ(report.footprint->frame_count, 1);
  EXPECT_EQ(report.footprint->beyond_horizon_count, 1);
}

TEST(SortieReport, TakesTheFootprintFromCorners) {
  v1::SortieManifest manifest = TwoFrames();
  for (const double number : {10.0, 60.001, 10.001, 60.001, 10.001, 60.0, 10.0, 60.0})
    manifest.mutable_frames(0)->add_corner_lon_lat_deg(number);
  const SortieReport report = ReportOn(manifest);
  ASSERT_TRUE(report.footprint.has_value());
  EXPECT_EQ(report.footprint->east_deg, 10.001);
  EXPECT_NEAR(report.footprint->gsd_m, 0.001 * 111320.0 * 0.5 / 400, 1e-5);
}

TEST(SortieReport, TellsPeopleAndProgramsTheSame) {
  v1::SortieManifest manifest = TwoFrames();
  v1::Note* note = manifest.add_notes();
  note->set_code("frame_unreadable");
  note->set_message("frame 1 cannot be read");
  note->set_severity(v1::WARNING);
  const SortieReport report = ReportOn(manifest);
  const std::string text = FormatReport(manifest, report);
  EXPECT_THAT(text, HasSubstr("3, 2 usable, 1 unreadable; 400 x 300 px"));
  EXPECT_THAT(text, HasSubstr("1 of 1 pairs of frames registered"));
  EXPECT_THAT(text, HasSubstr("warning    frame 1 cannot be read"));
  EXPECT_THAT(text, HasSubstr("telemetry  none"));
  const auto json = nlohmann::json::parse(FormatReportAsJson(manifest, report));
  EXPECT_EQ(json["usable"], 2);
  EXPECT_EQ(json["notes"][0]["code"], "frame_unreadable");
  EXPECT_TRUE(json["footprint"].is_null());
}

}  // namespace
}  // namespace trem
