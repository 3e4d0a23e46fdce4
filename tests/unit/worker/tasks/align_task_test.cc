// Goal: the ALIGN task turns windows and telemetry into map coordinates in the right zone, says what was lost, and fails clearly.
// Method: a simulated sortie (mosaic/align's synthetic.h) written as artefacts, with its cameras at real latitudes and longitudes.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <numbers>

#include "mosaic/align/align_graph.h"
#include "mosaic/raster/crs.h"
#include "mosaic/raster/scene_raster.h"
#include "proto/codec/convert.h"
#include "tests/unit/mosaic/align/synthetic.h"
#include "worker/tasks/align_input.h"
#include "worker/tasks/task.h"

namespace trem {
namespace {

using ::testing::HasSubstr;

constexpr double kDeg = 180.0 / std::numbers::pi;
const Eigen::Vector2d kOrigin(703000.0, 5635000.0);  // 2.9 degrees east of zone 30's central meridian: convergence matters there.

class AlignTask : public ::testing::Test {
 protected:
  void SetUp() override {
    root_ = std::filesystem::path(::testing::TempDir()) /
            ("align_task_" + std::string(::testing::UnitTest::GetInstance()->current_test_info()->name()));
    std::filesystem::remove_all(root_);
    Result<ArtefactStore> store = ArtefactStore::Open(root_);
    ASSERT_TRUE(store.ok());
    store_.emplace(std::move(*store));
  }
  void TearDown() override { std::filesystem::remove_all(root_); }

  void FillManifest(const align::SyntheticSortie& sortie) {
    manifest_.set_width_px(static_cast<std::uint32_t>(sortie.input.width_px));
    manifest_.set_height_px(static_cast<std::uint32_t>(sortie.input.height_px));
    Result<UtmFrame> map = UtmFrame::ForCrs("EPSG:32630");
    ASSERT_TRUE(map.ok());
    const Eigen::Vector2d origin_lat_lon = *map->Inverse(kOrigin);
    const double scale = *map->ScaleFactor(origin_lat_lon.x(), origin_lat_lon.y());
    map_from_world_.matrix << scale, 0.0, kOrigin.x(), 0.0, scale, kOrigin.y(), 0.0, 0.0, 1.0;
    for (std::size_t t = 0; t < sortie.world_from_sensor.size(); ++t) {
      v1::ManifestFrame* const frame = manifest_.add_frames();
      frame->set_name("f" + std::to_string(t) + ".png");
      if (t >= sortie.input.anchors.size()) continue;
      const align::FrameAnchor& anchor = sortie.input.anchors[t];
      const Eigen::Vector2d lat_lon = *map->Inverse(map_from_world_ * Eigen::Vector2d(anchor.pose->position_m.head<2>()));
      v1::Pose* const pose = frame->mutable_pose();
      pose->set_latitude_deg(lat_lon.x());
      pose->set_longitude_deg(lat_lon.y());
      pose->set_altitude_m(anchor.pose->position_m.z() + 120.0);
      pose->set_yaw_deg((anchor.pose->yaw_rad + *map->ConvergenceRad(lat_lon.x(), lat_lon.y())) * kDeg);
      pose->set_pitch_deg(anchor.pose->pitch_rad * kDeg);
      pose->set_roll_deg(anchor.pose->roll_rad * kDeg);
      pose->set_hfov_deg(2.0 * std::atan(0.5 * sortie.input.width_px / anchor.focal_px) * kDeg);
    }
    manifest_.set_ground_elevation_m(120.0);
  }

  v1::WindowResult WindowOf(const align::Segment& segment) {
    v1::WindowResult window;
    window.set_window_id(segment.window_id);
    *window.mutable_roi_in_sensor() = ToProto(segment.roi_in_sensor);
    v1::Segment* const out = window.add_segments();
    for (const align::ChainView& view : segment.chain) {
      v1::ChainView* const chain = out->add_chain();
      chain->set_frame_index(view.frame);
      ToProto(view.scene_from_sensor, chain->mutable_scene_from_sensor());
      for (int row = 0; row < 6; ++row) {
        for (int column = row; column < 6; ++column) chain->add_corner_covariance_px2(view.corner_covariance_px2(row, column));
      }
      chain->set_gain(view.gain);
      chain->set_offset(view.offset);
      for (const double x : {1e-6, 0.0, 2.5e-3}) chain->add_gain_offset_covariance(x);
      v1::FrameOutcome* const outcome = window.add_frames();
      outcome->set_frame_index(view.frame);
      outcome->set_outcome(v1::REGISTERED);
    }
    for (const align::Scene& scene : segment.scenes) {
      const std::filesystem::path path = store_->NewTemporaryPath(".tif");
      const Image<float> grey(scene.roi_in_scene.width(), scene.roi_in_scene.height(), 100.0F);
      EXPECT_TRUE(WriteSceneRaster(path, grey, grey).ok());
      const auto ref = store_->PutFile("scene.tif", path);
      EXPECT_TRUE(ref.ok());
      v1::EmittedScene* const emitted = out->add_scenes();
      emitted->set_scene_id(scene.scene_id);
      if (ref.ok()) *emitted->mutable_raster() = ToProto(*ref);
      *emitted->mutable_roi_in_scene() = ToProto(scene.roi_in_scene);
      emitted->set_frame_begin(scene.frame_begin);
      emitted->set_frame_end(scene.frame_end);
    }
    return window;
  }

  Result<v1::TaskResult> Run(std::vector<v1::WindowResult> windows, int threads = 1) {
    v1::TaskSpec spec = spec_;
    spec.set_key("k");
    spec.set_kind(v1::ALIGN);
    *spec.add_inputs() = *PutProtoArtefact(*store_, "manifest.pb", manifest_);
    for (const v1::WindowResult& window : windows) *spec.add_inputs() = *PutProtoArtefact(*store_, "window.pb", window);
    return RunAlignTask(spec, {&*store_, [](double) { return true; }, threads});
  }

  std::vector<v1::WindowResult> WindowsOf(const align::SyntheticSortie& sortie) {
    std::vector<v1::WindowResult> windows;
    for (const align::Segment& segment : sortie.input.segments) windows.push_back(WindowOf(segment));
    return windows;
  }

  v1::Alignment Read(const v1::TaskResult& result) {
    v1::Alignment alignment;
    EXPECT_EQ(result.outputs_size(), 1);
    EXPECT_EQ(result.outputs(0).name(), "alignment.pb");
    EXPECT_TRUE(ReadProtoArtefact(*store_, result.outputs(0), &alignment).ok());
    return alignment;
  }

  static const v1::Note* FindNote(const v1::TaskResult& result, const std::string& code) {
    for (const v1::Note& note : result.notes()) {
      if (note.code() == code) return &note;
    }
    return nullptr;
  }

  std::filesystem::path root_;
  std::optional<ArtefactStore> store_;
  v1::SortieManifest manifest_;
  v1::TaskSpec spec_;
  Homography map_from_world_;
};

TEST_F(AlignTask, PutsScenesWhereTheGroundIsInTheUtmZoneOfTheArea) {
  align::SyntheticOptions options;
  options.frame_count = 20;
  options.pitch_deg = -60.0;
  const align::SyntheticSortie sortie = MakeSortie(options);
  FillManifest(sortie);
  const auto result = Run(WindowsOf(sortie));
  ASSERT_TRUE(result.ok()) << result.status().ToString();
  const v1::Alignment alignment = Read(*result);
  EXPECT_TRUE(alignment.georeferenced());
  EXPECT_THAT(alignment.grid().crs_wkt(), HasSubstr("UTM zone 30N"));
  const auto grid = FromProto(alignment.grid());
  ASSERT_TRUE(grid.ok());
  EXPECT_EQ(static_cast<int>(result->align().tile_count()), grid->tile_count());
  ASSERT_EQ(alignment.scenes_size(), 12);
  for (const v1::AlignedScene& scene : alignment.scenes()) {
    const auto map_from_scene = HomographyFromProto(scene.world_from_scene(), "x");
    ASSERT_TRUE(map_from_scene.ok());
    const Roi roi = sortie.input.segments[scene.window_id()].scenes[scene.scene_id()].roi_in_scene;
    for (const Eigen::Vector2d& x : align::RoiCorners(roi)) {
      const Eigen::Vector2d truth = map_from_world_ * (sortie.world_from_scene[scene.window_id()] * x);
      EXPECT_LT((*map_from_scene * x - truth).norm(), 0.5 * sortie.gsd_m) << scene.window_id();
      EXPECT_GE(grid->PixelFromWorld(*map_from_scene * x).minCoeff(), -0.01);
    }
    EXPECT_GT(scene.position_sigma(), 0.3) << "the shared GPS error of 1 m is part of it";
    EXPECT_LT(scene.position_sigma(), 3.0);
  }
  EXPECT_EQ(alignment.frames_size(), 20);
  EXPECT_NE(FindNote(*result, "georeferenced"), nullptr);
}

TEST_F(AlignTask, IsLocalWithoutTelemetryAndNamesLostFrames) {
  align::SyntheticOptions options;
  options.frame_count = 20;
  options.telemetry = false;
  const align::SyntheticSortie sortie = MakeSortie(options);
  FillManifest(sortie);
  for (int k = 0; k < 3; ++k) manifest_.add_frames()->set_name("late" + std::to_string(k) + ".png");
  std::vector<v1::WindowResult> windows = WindowsOf(sortie);
  for (std::uint32_t frame : {20U, 21U, 22U}) {
    v1::FrameOutcome* const outcome = windows[0].add_frames();
    outcome->set_frame_index(frame);
    outcome->set_outcome(v1::LOST);
    outcome->set_reason("correlation 0.10 below 0.5");
  }
  const auto result = Run(windows);
  ASSERT_TRUE(result.ok()) << result.status().ToString();
  const v1::Alignment alignment = Read(*result);
  EXPECT_FALSE(alignment.georeferenced());
  EXPECT_THAT(alignment.grid().crs_wkt(), HasSubstr("local, sensor pixels"));
  EXPECT_NEAR(alignment.grid().gsd(), 1.0 / 3.0, 0.02);
  const v1::Note* const lost = FindNote(*result, "frames_lost");
  ASSERT_NE(lost, nullptr);
  EXPECT_EQ(lost->subject(), "frames late0.png to late2.png");
  EXPECT_THAT(lost->message(), HasSubstr("correlation 0.10 below 0.5"));
  const v1::Note* const local = FindNote(*result, "local_coordinates");
  ASSERT_NE(local, nullptr);
  EXPECT_EQ(local->severity(), v1::WARNING);
}

TEST_F(AlignTask, GivesTheSameBytesForAnyOrderOfWindowsAndNumberOfThreads) {
  align::SyntheticOptions options;
  options.frame_count = 30;
  const align::SyntheticSortie sortie = MakeSortie(options);
  FillManifest(sortie);
  std::vector<v1::WindowResult> windows = WindowsOf(sortie);
  const auto first = Run(windows);
  std::reverse(windows.begin(), windows.end());
  const auto second = Run(windows, 4);
  ASSERT_TRUE(first.ok() && second.ok());
  EXPECT_EQ(first->outputs(0).sha256(), second->outputs(0).sha256());
  EXPECT_EQ(SerializeDeterministic(*first), SerializeDeterministic(*second));
}

TEST_F(AlignTask, RefusesACrsInDegreesAndAnUnknownOneByName) {
  align::SyntheticOptions options;
  options.frame_count = 10;
  const align::SyntheticSortie sortie = MakeSortie(options);
  FillManifest(sortie);
  for (const char* crs : {"EPSG:4326", "EPSG:123456789"}) {
    spec_.mutable_sortie()->mutable_mosaic()->set_crs(crs);
    const auto result = Run(WindowsOf(sortie));
    ASSERT_FALSE(result.ok());
    EXPECT_EQ(result.status().code(), StatusCode::kInvalidInput);
    EXPECT_THAT(result.status().message(), HasSubstr(crs));
    EXPECT_THAT(result.status().message(), HasSubstr("mosaic.crs"));
  }
}

TEST_F(AlignTask, ExplainsWhyThereIsNothingToAlign) {
  manifest_.set_width_px(64);
  manifest_.set_height_px(48);
  v1::WindowResult window;
  for (std::uint32_t frame : {0U, 1U}) {
    manifest_.add_frames()->set_name("f");
    v1::FrameOutcome* const outcome = window.add_frames();
    outcome->set_frame_index(frame);
    outcome->set_outcome(v1::LOST);
    outcome->set_reason("no texture");
  }
  const auto result = Run({window});
  ASSERT_FALSE(result.ok());
  EXPECT_EQ(result.status().code(), StatusCode::kFailed);
  EXPECT_THAT(result.status().message(), HasSubstr("2: no texture"));
  EXPECT_THAT(result.status().message(), HasSubstr("try"));
}

TEST_F(AlignTask, NamesTheWindowWhoseChainIsBroken) {
  align::SyntheticOptions options;
  options.frame_count = 10;
  const align::SyntheticSortie sortie = MakeSortie(options);
  FillManifest(sortie);
  std::vector<v1::WindowResult> windows = WindowsOf(sortie);
  windows[2].mutable_segments(0)->mutable_chain(1)->mutable_corner_covariance_px2()->RemoveLast();
  const auto result = Run(windows);
  ASSERT_FALSE(result.ok());
  EXPECT_EQ(result.status().code(), StatusCode::kCorrupt);
  EXPECT_THAT(result.status().message(), HasSubstr("window 2: corner_covariance_px2 has 20 numbers"));
}

// What the spec lets the alignment find of the camera, what the manifest knows of the ground, and whose telemetry a frame has.
TEST_F(AlignTask, TakesGroundCameraOptionsAndRecordingsUp) {
  align::SyntheticOptions options;
  options.frame_count = 10;
  const align::SyntheticSortie sortie = MakeSortie(options);
  FillManifest(sortie);
  v1::Telemetry* telemetry = spec_.mutable_sortie()->mutable_telemetry();
  telemetry->set_focal_sigma_percent(2.0);
  telemetry->set_estimate_distortion(true);
  telemetry->set_boresight(v1::CORRECTION_ON);
  const v1::Pose& pose = manifest_.frames(0).pose();
  v1::GroundGrid* ground = manifest_.mutable_ground();
  ground->set_west_deg(pose.longitude_deg() - 0.05);
  ground->set_north_deg(pose.latitude_deg() + 0.05);
  constexpr int kNodes = 21;
  ground->set_longitude_step_deg(0.1 / (kNodes - 1));
  ground->set_latitude_step_deg(-0.1 / (kNodes - 1));
  ground->set_width(kNodes);
  ground->set_height(kNodes);
  for (int row = 0; row < kNodes; ++row) {
    for (int column = 0; column < kNodes; ++column) ground->add_elevation_m(100.0F + 0.5F * static_cast<float>(column));
  }
  for (const std::uint32_t begin : {0U, 6U}) {
    v1::RecordingManifest* recording = manifest_.add_recordings();
    recording->set_frame_begin(begin);
    recording->set_frame_end(begin == 0 ? 6 : 10);
    recording->set_position_sigma_m(begin == 0 ? 1.0 : 3.0);
    recording->set_attitude_sigma_deg(0.4);
  }
  for (int t = 6; t < 10; ++t) manifest_.mutable_frames(t)->mutable_pose()->set_attitude_sigma_deg(0.3);
  const Result<AlignTaskInput> input = MakeAlignInput(spec_.sortie(), manifest_, WindowsOf(sortie));
  ASSERT_TRUE(input.ok()) << input.status().message();
  EXPECT_NEAR(input->align.focal_sigma, 0.02, 1e-12);
  EXPECT_TRUE(input->align.estimate_distortion);
  EXPECT_EQ(input->align.boresight, align::Boresight::kEstimated);
  ASSERT_NE(input->align.ground, nullptr);
  EXPECT_NEAR(*input->align.ground->ElevationAt(input->align.anchors[0].pose->position_m.head<2>()), 105.0, 0.2);
  EXPECT_EQ(input->align.anchors[5].recording, 0U);
  EXPECT_EQ(input->align.anchors[6].recording, 1U);
  EXPECT_NEAR(input->align.SigmasOf(1).position_m, 3.0, 1e-12);
  EXPECT_NEAR(input->align.SigmasOf(1).attitude_rad * kDeg, 0.5, 1e-9) << "what poses wander is part of what their average may be off by";
}

TEST_F(AlignTask, DoesNotUseCamerasBelowTheGroundAndSaysWhatToSet) {
  align::SyntheticOptions options;
  options.frame_count = 10;
  const align::SyntheticSortie sortie = MakeSortie(options);
  FillManifest(sortie);
  spec_.mutable_sortie()->mutable_telemetry()->set_ground_elevation_m(5000.0);
  const auto result = Run(WindowsOf(sortie));
  ASSERT_TRUE(result.ok()) << result.status().ToString();
  EXPECT_FALSE(Read(*result).georeferenced());
  const v1::Note* const note = FindNote(*result, "camera_below_ground");
  ASSERT_NE(note, nullptr);
  EXPECT_THAT(note->message(), HasSubstr("telemetry.ground_elevation_m"));
}

}  // namespace
}  // namespace trem
