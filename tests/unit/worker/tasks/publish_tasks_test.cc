// Goal: COMPOSITE and EXPORT turn aligned scenes into the files that users get. Method: scenes cut from one analytic ground, stored with
// the messages that ENHANCE and ALIGN would write; every tile composited and exported through the tasks; the files compared with the
// ground and opened with the tools that users have.
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <sstream>

#include "mosaic/base/file.h"
#include "mosaic/raster/crs.h"
#include "mosaic/raster/gdal_env.h"
#include "mosaic/raster/geotiff.h"
#include "mosaic/raster/scene_raster.h"
#include "proto/codec/convert.h"
#include "tests/support/paths.h"
#include "tests/support/subprocess.h"
#include "worker/tasks/task.h"

namespace trem {
namespace {

constexpr const char* kValidator = "/usr/lib/python3/dist-packages/osgeo_utils/samples/validate_cloud_optimized_geotiff.py";
constexpr double kGreyOffset = 1000.0, kGreyScale = 16.0;

// Fields with hedges, a road and a few houses, in metres; values near 0..255.
double Ground(double x, double y) {
  double value = 110.0 + 25.0 * std::sin(x / 11.0) * std::cos(y / 17.0) + 12.0 * std::sin((x + 2.0 * y) / 4.0);
  if (std::abs(y - 30.0 - 8.0 * std::sin(x / 25.0)) < 3.0) value = 190.0;
  const double hx = x - 12.0 * std::floor(x / 12.0), hy = y - 15.0 * std::floor(y / 15.0);
  if (std::hypot(hx - 6.0, hy - 7.0) < 2.2) value = 60.0;
  return value;
}

// A small job with everything that ENHANCE and ALIGN leave behind.
class PublishTasks : public ::testing::Test {
 protected:
  static constexpr double kOriginX = 500000.0, kOriginY = 5000000.0, kGsd = 0.1;

  void SetUp() override {
    store_.emplace(*ArtefactStore::Open(folder_ / "store"));
    context_.store = &*store_;
    context_.progress = [](double) { return true; };
  }

  void MakeJob(bool georeferenced) {
    MosaicGrid grid;
    grid.crs_wkt = georeferenced ? *CrsWkt("EPSG:32630") : LocalPixelCrsWkt();
    grid.origin_x = kOriginX;
    grid.origin_y = kOriginY;
    grid.gsd = kGsd;
    grid.width = 900;
    grid.height = 600;
    grid.tile_size = 400;
    *alignment_.mutable_grid() = ToProto(grid);
    alignment_.set_georeferenced(georeferenced);
    alignment_.set_gauge("fixed by <tests> & hope");
    alignment_.set_piece_count(1);
    alignment_.set_tie_rms_px(0.12);
    MakeManifest();
    for (std::uint32_t i = 0; i < 12; ++i) MakeWindow(i);
    // A window in which nothing could be registered.
    v1::WindowResult empty;
    empty.set_window_id(12);
    AddOutcome(&empty, 9, v1::LOST, "correlation 0.1");
    AddOutcome(&empty, 10, v1::SKIPPED, "blank");
    windows_.push_back(*PutProtoArtefact(*store_, "window.pb", empty));
    alignment_ref_ = *PutProtoArtefact(*store_, "alignment.pb", alignment_);
    manifest_ref_ = *PutProtoArtefact(*store_, "manifest.pb", manifest_);
  }

  static void AddOutcome(v1::WindowResult* window, std::uint32_t frame, v1::OutcomeCode code, const std::string& reason) {
    v1::FrameOutcome* outcome = window->add_frames();
    outcome->set_frame_index(frame);
    outcome->set_outcome(code);
    outcome->set_reason(reason);
  }

  void MakeManifest() {
    manifest_.set_source_path("/data/a \"sortie\"");
    manifest_.set_grey_offset(kGreyOffset);
    manifest_.set_grey_scale(kGreyScale);
    for (int i = 0; i < 12; ++i) {
      v1::ManifestFrame* frame = manifest_.add_frames();
      frame->set_name("frame," + std::to_string(i) + ".png");
      frame->set_time_s(0.04 * i);
    }
    manifest_.mutable_frames(11)->set_state(v1::FRAME_UNREADABLE);
    v1::Note* note = manifest_.add_notes();
    note->set_code("frame_unreadable");
    note->set_subject("frame,11.png");
    note->set_message("is <b>not</b> an image");
    note->set_severity(v1::WARNING);
  }

  // Window i: one scene of 340 x 330 cells on a 4 x 3 raster over the mosaic, slightly turned, with its own gain.
  void MakeWindow(std::uint32_t i) {
    const Roi raster_in_scene{-5, 4, 335, 334};
    Homography world_from_scene;
    const double angle = 0.02 * (static_cast<double>(i % 5) - 2.0), scale = 0.095;
    const double x0 = kOriginX - 0.4 + 19.0 * (i % 4), y0 = kOriginY + 0.4 - 14.5 * (i / 4);
    world_from_scene.matrix << scale * std::cos(angle), -scale * std::sin(angle), x0, -scale * std::sin(angle), -scale * std::cos(angle),
        y0, 0.0, 0.0, 1.0;
    const double gain = 1.0 + 0.03 * i, offset = 2.0 * i - 10.0;
    Image<float> intensity(340, 330), information(340, 330, 6.0f);
    for (int y = 0; y < 330; ++y) {
      for (int x = 0; x < 340; ++x) {
        const Eigen::Vector2d at = world_from_scene * Eigen::Vector2d(x + raster_in_scene.x0, y + raster_in_scene.y0);
        intensity.at(x, y) = static_cast<float>((Ground(at.x() - kOriginX, kOriginY - at.y()) - offset) / gain);
      }
    }
    const std::filesystem::path path = store_->NewTemporaryPath(".tif");
    ASSERT_TRUE(WriteSceneRaster(path, intensity, information).ok());
    v1::WindowResult window;
    window.set_window_id(i);
    *window.mutable_roi_in_sensor() = ToProto(Roi{10, 20, 110, 120});
    v1::Segment* segment = window.add_segments();
    v1::ChainView* view = segment->add_chain();
    view->set_frame_index(i % 9);
    ToProto(Affine{}, view->mutable_scene_from_sensor());
    view->set_gain(1.0);
    v1::EmittedScene* scene = segment->add_scenes();
    *scene->mutable_raster() = ToProto(*store_->PutFile("scene-000.tif", path));
    *scene->mutable_roi_in_scene() = ToProto(raster_in_scene);
    AddOutcome(&window, i % 9, v1::REGISTERED, "");
    windows_.push_back(*PutProtoArtefact(*store_, "window.pb", window));

    v1::AlignedScene* aligned = alignment_.add_scenes();
    aligned->set_window_id(i);
    ToProto(world_from_scene, aligned->mutable_world_from_scene());
    aligned->set_gain(gain);
    aligned->set_offset(offset);
    aligned->set_position_sigma(0.25);
    if (i >= 9) return;
    v1::AlignedFrame* frame = alignment_.add_frames();
    frame->set_frame_index(i);
    ToProto(world_from_scene, frame->mutable_world_from_sensor());
  }

  Result<v1::TaskResult> Composite(std::uint32_t tile) const {
    v1::TaskSpec spec;
    spec.set_kind(v1::COMPOSITE);
    spec.mutable_sortie()->mutable_tre()->set_ratio(3);
    spec.mutable_composite()->set_tile_index(tile);
    *spec.add_inputs() = alignment_ref_;
    for (const v1::ArtefactRef& window : windows_) *spec.add_inputs() = window;
    return RunCompositeTask(spec, context_);
  }

  // All tiles, then the export. Fails the test when a task does.
  v1::TaskResult RunJob(const std::set<std::uint32_t>& missing_tiles = {}) const {
    v1::TaskSpec spec;
    spec.set_kind(v1::EXPORT);
    spec.mutable_sortie()->set_name("a <test> sortie");
    *spec.add_inputs() = alignment_ref_;
    *spec.add_inputs() = manifest_ref_;
    for (const v1::ArtefactRef& window : windows_) *spec.add_inputs() = window;
    for (std::uint32_t tile = 0; tile < 6; ++tile) {
      if (missing_tiles.count(tile) > 0) {
        spec.mutable_export_params()->add_missing_tiles(tile);
        spec.mutable_export_params()->add_holes()->set_message("tile <" + std::to_string(tile) + "> was given up");
        continue;
      }
      const auto result = Composite(tile);
      EXPECT_TRUE(result.ok()) << result.status().message();
      if (!result.ok()) return {};
      EXPECT_EQ(result->outputs(0).name(), "tile.tif");
      *spec.add_inputs() = result->outputs(0);
    }
    const auto result = RunExportTask(spec, context_);
    EXPECT_TRUE(result.ok()) << result.status().message();
    return result.ok() ? *result : v1::TaskResult{};
  }

  std::filesystem::path Output(const v1::TaskResult& result, const std::string& name) const {
    for (const v1::ArtefactRef& ref : result.outputs()) {
      if (ref.name() == name) return *store_->Locate(FromProto(ref));
    }
    ADD_FAILURE() << "no output " << name;
    return {};
  }

  std::string Text(const v1::TaskResult& result, const std::string& name) const { return *ReadFile(Output(result, name), 1 << 26); }

  testing::TempDir folder_;
  std::optional<ArtefactStore> store_;
  TaskContext context_;
  v1::SortieManifest manifest_;
  v1::Alignment alignment_;
  std::vector<v1::ArtefactRef> windows_;
  v1::ArtefactRef alignment_ref_, manifest_ref_;
};

TEST_F(PublishTasks, TheMosaicIsTheGroundInTheSourcesGreyLevels) {
  MakeJob(true);
  const v1::TaskResult result = RunJob();
  const auto mosaic = ReadFloatBands(Output(result, "mosaic.tif"), {0}, std::nullopt, 1 << 24);
  const auto quality = ReadFloatBands(Output(result, "mosaic_quality.tif"), {0, 1, 2}, std::nullopt, 1 << 24);
  ASSERT_TRUE(mosaic.ok() && quality.ok());
  long long covered = 0, wrong = 0;
  for (int y = 0; y < 600; ++y) {
    for (int x = 0; x < 900; ++x) {
      const float value = (*mosaic)[0].at(x, y);
      ASSERT_EQ(std::isnan(value), (*quality)[0].at(x, y) == 0.0f) << x << " " << y;
      if (std::isnan(value)) continue;
      ++covered;
      ASSERT_NEAR((*quality)[2].at(x, y), 0.25f, 1e-6f);
      const double expected = kGreyOffset + kGreyScale * Ground(x * kGsd, y * kGsd);
      // Only the edges of houses and road, which no interpolation follows, may differ.
      if (std::abs(value - expected) > kGreyScale * 2.0) ++wrong;
    }
  }
  EXPECT_GT(covered, 0.9 * 900 * 600);
  EXPECT_LT(wrong, 0.06 * covered);
}

TEST_F(PublishTasks, EveryRasterIsAValidCogThatSaysWhatItIs) {
  ASSERT_TRUE(std::filesystem::exists(kValidator)) << kValidator << " is missing: install python3-gdal (deploy/bootstrap.sh does)";
  MakeJob(true);
  const v1::TaskResult result = RunJob();
  for (const char* name : {"mosaic.tif", "mosaic_quality.tif", "mosaic_source.tif"}) {
    std::filesystem::copy_file(Output(result, name), folder_ / name);
    testing::Subprocess validator({"/usr/bin/python3", kValidator, (folder_ / name).string()});
    const auto verdict = validator.Wait(std::chrono::seconds(60));
    EXPECT_TRUE(verdict && verdict->code == 0) << validator.Stdout() << validator.Stderr();
    testing::Subprocess gdalinfo({"gdalinfo", "-checksum", "-norat", (folder_ / name).string()});
    const auto exit = gdalinfo.Wait(std::chrono::seconds(60));
    EXPECT_TRUE(exit && exit->code == 0) << gdalinfo.Stderr();
    const std::string info = gdalinfo.Stdout();
    for (const char* expected : {"Size is 900, 600", "TREM_SORTIE=a <test> sortie", "TREM_FRAMES_USED=9 of 12", "UTM zone 30N",
                                 "Origin = (499999.9500000000", "Checksum="}) {
      EXPECT_NE(info.find(expected), std::string::npos) << name << ": no " << expected << " in\n" << info;
    }
  }
}

TEST_F(PublishTasks, TheChainListsEveryFrameWithItsFate) {
  MakeJob(true);
  const std::string csv = Text(RunJob(), "mosaic_chain.csv");
  std::istringstream lines(csv);
  std::string line;
  ASSERT_TRUE(std::getline(lines, line));
  const auto columns = std::count(line.begin(), line.end(), ',');
  int rows = 0;
  while (std::getline(lines, line)) {
    ++rows;
    // Frame names hold one comma each, inside quotes.
    EXPECT_EQ(std::count(line.begin(), line.end(), ','), columns + 1) << line;
  }
  EXPECT_EQ(rows, 12 + 2 + 1);  // Registered ones, the two of the last window, the unreadable frame.
  EXPECT_NE(csv.find("\n0,\"frame,0.png\",0,0,0,registered,,1,0,0,0,1,0,0,0,1,0,0,0,0,0.09"), std::string::npos) << csv;
  EXPECT_NE(csv.find("9,\"frame,9.png\",0.36,12,,lost,correlation 0.1,,"), std::string::npos) << csv;
  EXPECT_NE(csv.find("11,\"frame,11.png\",0.44,,,skipped,unreadable,,"), std::string::npos) << csv;
}

TEST_F(PublishTasks, FootprintsAreLongitudeAndLatitudeCounterClockwise) {
  MakeJob(true);
  const auto json = nlohmann::json::parse(Text(RunJob(), "mosaic_windows.geojson"));
  ASSERT_EQ(json["features"].size(), 12u);
  for (const auto& feature : json["features"]) {
    const auto& ring = feature["geometry"]["coordinates"][0];
    ASSERT_EQ(ring.size(), 5u);
    EXPECT_EQ(ring[0], ring[4]);
    double area = 0.0;
    for (std::size_t i = 0; i < 4; ++i) {
      const double x0 = ring[i][0], y0 = ring[i][1], x1 = ring[i + 1][0], y1 = ring[i + 1][1];
      area += (x0 - ring[0][0].get<double>()) * (y1 - ring[0][1].get<double>()) -
              (x1 - ring[0][0].get<double>()) * (y0 - ring[0][1].get<double>());
      // Easting 500 km is the central meridian of zone 30; northing 5000 km is near 45.15 degrees.
      EXPECT_NEAR(x0, -3.0, 0.01);
      EXPECT_NEAR(y0, 45.15, 0.01);
    }
    EXPECT_GT(area, 0.0);
  }
}

TEST_F(PublishTasks, TheReportIsSelfContainedAndEscaped) {
  MakeJob(true);
  const v1::TaskResult result = RunJob();
  const std::string html = Text(result, "mosaic_report.html");
  for (const char* expected : {"a &lt;test&gt; sortie", "9 of 12 registered; 1 lost; 2 not usable", "fixed by &lt;tests&gt; &amp; hope",
                               "is &lt;b&gt;not&lt;/b&gt; an image", "UTM zone 30N", "data:image/png;base64,iVBOR", "correlation 0.1"}) {
    EXPECT_NE(html.find(expected), std::string::npos) << expected;
  }
  for (const char* unwanted : {"<script", "http://", "https://", "<b>not", "<tests>"})
    EXPECT_EQ(html.find(unwanted), std::string::npos) << unwanted;
  EXPECT_EQ(Text(result, "mosaic_preview.png").substr(1, 3), "PNG");
}

TEST_F(PublishTasks, WithoutTelemetryEverythingSaysSo) {
  MakeJob(false);
  const v1::TaskResult result = RunJob();
  const GdalDatasetPtr dataset = *OpenTiff(Output(result, "mosaic.tif"), "mosaic");
  ASSERT_NE(dataset->GetSpatialRef(), nullptr);
  EXPECT_TRUE(dataset->GetSpatialRef()->IsLocal());
  EXPECT_NE(std::string(dataset->GetMetadataItem("TREM_COORDINATES")).find("no telemetry"), std::string::npos);
  EXPECT_NE(Text(result, "mosaic_report.html").find("Local coordinates: no telemetry"), std::string::npos);
  const auto json = nlohmann::json::parse(Text(result, "mosaic_windows.geojson"));
  EXPECT_NE(json["coordinate_reference"].get<std::string>().find("not longitude and latitude"), std::string::npos);
  EXPECT_NE(json["features"][0]["properties"]["coordinate_reference"].get<std::string>().find("local"), std::string::npos);
  EXPECT_NEAR(json["features"][0]["geometry"]["coordinates"][0][0][0].get<double>(), kOriginX, 50.0);
}

TEST_F(PublishTasks, TheSameJobGivesTheSameBytes) {
  MakeJob(true);
  const v1::TaskResult a = RunJob(), b = RunJob();
  EXPECT_EQ(SerializeDeterministic(a), SerializeDeterministic(b));
  EXPECT_EQ(a.outputs_size(), 7);
}

TEST_F(PublishTasks, ATileWithoutScenesIsAnEmptyTile) {
  MakeJob(true);
  alignment_.mutable_grid()->set_origin_x(kOriginX + 1e4);
  alignment_ref_ = *PutProtoArtefact(*store_, "alignment.pb", alignment_);
  const v1::TaskResult result = RunJob();
  const auto mosaic = ReadFloatBands(Output(result, "mosaic.tif"), {0}, std::nullopt, 1 << 24);
  ASSERT_TRUE(mosaic.ok());
  for (const float value : (*mosaic)[0].pixels()) ASSERT_TRUE(std::isnan(value));
  EXPECT_EQ(result.notes(0).code(), "mosaic_empty");
}

TEST_F(PublishTasks, AMissingTileIsNodataAndTheOthersAreAsEver) {
  MakeJob(true);
  const auto whole = ReadFloatBands(Output(RunJob(), "mosaic.tif"), {0}, std::nullopt, 1 << 24);
  const v1::TaskResult result = RunJob({0, 4});
  const auto mosaic = ReadFloatBands(Output(result, "mosaic.tif"), {0}, std::nullopt, 1 << 24);
  const auto quality = ReadFloatBands(Output(result, "mosaic_quality.tif"), {0}, std::nullopt, 1 << 24);
  ASSERT_TRUE(whole.ok() && mosaic.ok() && quality.ok());
  int there_before = 0;
  for (int y = 0; y < 600; ++y) {
    for (int x = 0; x < 900; ++x) {
      const int tile = y / 400 * 3 + x / 400;
      const float value = (*mosaic)[0].at(x, y), before = (*whole)[0].at(x, y);
      if (tile == 0 || tile == 4) {
        there_before += std::isnan(before) ? 0 : 1;
        ASSERT_TRUE(std::isnan(value)) << x << " " << y;
        ASSERT_EQ((*quality)[0].at(x, y), 0.0f) << x << " " << y;
      } else {
        ASSERT_TRUE(value == before || (std::isnan(value) && std::isnan(before))) << x << " " << y;
      }
    }
  }
  EXPECT_GT(there_before, 100'000);
  EXPECT_NE(Text(result, "mosaic_report.html").find("tile &lt;4&gt; was given up"), std::string::npos);
}

TEST_F(PublishTasks, BrokenInputsAreNamed) {
  MakeJob(true);
  EXPECT_EQ(Composite(6).status().code(), StatusCode::kInvalidInput) << "there are tiles 0 to 5";
  const v1::ArtefactRef complete = windows_[3];
  windows_.erase(windows_.begin() + 3);
  const auto missing = Composite(0);
  ASSERT_FALSE(missing.ok());
  EXPECT_NE(missing.status().message().find("scene 0 of window 3"), std::string::npos) << missing.status().message();
  windows_.push_back(complete);
  // Damage to one byte of a scene raster is found before its pixels are used.
  v1::WindowResult window;
  ASSERT_TRUE(ReadProtoArtefact(*store_, windows_[0], &window).ok());
  const std::filesystem::path scene = *store_->Locate(FromProto(window.segments(0).scenes(0).raster()));
  std::string bytes = *ReadFile(scene, 1 << 26);
  bytes[bytes.size() / 2] = static_cast<char>(bytes[bytes.size() / 2] ^ 0x10);
  ASSERT_TRUE(WriteFileAtomically(scene, bytes).ok());
  EXPECT_EQ(Composite(0).status().code(), StatusCode::kCorrupt);
}

}  // namespace
}  // namespace trem
