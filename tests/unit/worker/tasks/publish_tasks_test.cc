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
#include "tests/unit/worker/tasks/stac_validator.h"
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
    *spec.mutable_sortie()->mutable_mosaic() = mosaic_;
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
    *spec.mutable_sortie()->mutable_mosaic() = mosaic_;
    *spec.mutable_export_params()->mutable_notes() = manifest_.notes();
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
  v1::Mosaic mosaic_;
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

TEST_F(PublishTasks, TheSameJobGivesTheSameBytesForAnyNumberOfThreads) {
  MakeJob(true);
  const v1::TaskResult a = RunJob();
  context_.threads = 4;
  const v1::TaskResult b = RunJob();
  EXPECT_EQ(SerializeDeterministic(a), SerializeDeterministic(b));
  EXPECT_EQ(a.outputs_size(), 8);
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
  EXPECT_TRUE(result.notes(0).hole());
}

TEST_F(PublishTasks, ATileNeedsOnlyTheWindowsThatReachIt) {
  MakeJob(true);
  const auto all = Composite(0);
  // Windows 3, 7 and 11 lie in the raster's last column, from 57 m on: beyond the tile's 40 m.
  for (const std::size_t i : {11U, 7U, 3U}) windows_.erase(windows_.begin() + static_cast<std::ptrdiff_t>(i));
  const auto fewer = Composite(0);
  ASSERT_TRUE(all.ok() && fewer.ok());
  EXPECT_EQ(all->outputs(0).sha256(), fewer->outputs(0).sha256());
}

TEST_F(PublishTasks, ACutlineLeavesNodataOutside) {
  MakeJob(true);
  v1::CutlineRing* ring = alignment_.mutable_cutline()->add_rings();
  for (const double number : {kOriginX + 20.0, kOriginY - 10.0, kOriginX + 60.0, kOriginY - 10.0, kOriginX + 60.0, kOriginY - 50.0,
                              kOriginX + 20.0, kOriginY - 50.0}) {
    ring->add_x_y(number);
  }
  alignment_ref_ = *PutProtoArtefact(*store_, "alignment.pb", alignment_);
  const auto mosaic = ReadFloatBands(Output(RunJob(), "mosaic.tif"), {0}, std::nullopt, 1 << 24);
  ASSERT_TRUE(mosaic.ok());
  for (int y = 0; y < 600; ++y) {
    for (int x = 0; x < 900; ++x) {
      const bool inside = x > 200 && x < 600 && y > 100 && y < 500, outside = x < 199 || x > 601 || y < 99 || y > 501;
      if (!inside && !outside) continue;
      ASSERT_EQ(std::isnan((*mosaic)[0].at(x, y)), outside) << x << " " << y;
    }
  }
}

TEST_F(PublishTasks, TheSourcesIntegerTypeAndZstdAreWrittenWhenAsked) {
  MakeJob(true);
  manifest_.set_grey_max(65535.0);
  manifest_ref_ = *PutProtoArtefact(*store_, "manifest.pb", manifest_);
  const v1::TaskResult plain = RunJob();
  mosaic_.set_pixel_type(v1::SOURCE_TYPE);
  mosaic_.set_compression(v1::ZSTD);
  mosaic_.set_estimator(v1::WEIGHTED_MEDIAN);
  const v1::TaskResult result = RunJob();
  const GdalDatasetPtr dataset = *OpenTiff(Output(result, "mosaic.tif"), "mosaic");
  EXPECT_EQ(dataset->GetRasterBand(1)->GetRasterDataType(), GDT_UInt16);
  EXPECT_EQ(dataset->GetRasterBand(1)->GetNoDataValue(), 0.0);
  EXPECT_STREQ(dataset->GetMetadataItem("COMPRESSION", "IMAGE_STRUCTURE"), "ZSTD");
  const auto floats = ReadFloatBands(Output(plain, "mosaic.tif"), {0}, std::nullopt, 1 << 24);
  std::vector<float> row(900);
  for (const int y : {100, 300, 599}) {
    ASSERT_EQ(dataset->GetRasterBand(1)->RasterIO(GF_Read, 0, y, 900, 1, row.data(), 900, 1, GDT_Float32, 0, 0, nullptr), CE_None);
    for (int x = 0; x < 900; ++x) {
      const float value = (*floats)[0].at(x, y);
      ASSERT_EQ(row[static_cast<std::size_t>(x)], std::isnan(value) ? 0.0f : std::round(value)) << x << " " << y;
    }
  }
  const auto item = nlohmann::json::parse(Text(result, "mosaic.stac.json"));
  EXPECT_EQ(item["assets"]["mosaic"]["raster:bands"][0]["data_type"], "uint16");
}

// Method: the npm package is asked about the item with and without a place on Earth, and about items with one fault each, which the schema
// that knows the field must refuse: else a validator that read no schema would do. Without schemas the test says so.
TEST_F(PublishTasks, TheStacItemIsValidForTheStacNodeValidator) {
  const auto validator = testing::StacValidator::Install(folder_ / "npm");
  if (!validator) GTEST_SKIP() << "skipped: npm cannot install stac-node-validator";
  nlohmann::json item;
  for (const bool georeferenced : {false, true}) {
    windows_.clear();
    alignment_.Clear();
    manifest_.Clear();
    MakeJob(georeferenced);
    item = nlohmann::json::parse(Text(RunJob(), "mosaic.stac.json"));
    const auto verdict = validator->Check(item.dump());
    if (verdict.without_schemas) GTEST_SKIP() << "skipped: the validator cannot fetch its schemas: " << verdict.said.substr(0, 300);
    EXPECT_TRUE(verdict.valid) << verdict.said;
    std::set<std::string> schemas = item["stac_extensions"];
    EXPECT_EQ(schemas.size(), 4U);
    schemas.insert("Item");
    EXPECT_EQ(verdict.accepted_by, schemas) << verdict.said;
  }
  const std::string extension = "https://stac-extensions.github.io/";
  const struct {
    nlohmann::json::json_pointer field;
    nlohmann::json value;
    std::string refused_by;
  } faults[] = {{"/geometry/type"_json_pointer, "Rectangle", "Item"},
                {"/properties/datetime"_json_pointer, "1970-01-01 00:00", "Item"},
                {"/properties/gsd"_json_pointer, 0.0, "Item"},
                {"/assets/mosaic/href"_json_pointer, nullptr, "Item"},
                {"/properties/proj:transform"_json_pointer, {0.1, 0.0}, extension + "projection/v1.1.0/schema.json"},
                {"/assets/mosaic/raster:bands/0/nodata"_json_pointer, "NaN", extension + "raster/v1.1.0/schema.json"},
                {"/assets/mosaic/file:checksum"_json_pointer, "sha256", extension + "file/v2.1.0/schema.json"},
                {"/properties/processing:software"_json_pointer, "trem", extension + "processing/v1.1.0/schema.json"}};
  for (const auto& fault : faults) {
    nlohmann::json broken = item;
    ASSERT_TRUE(broken.contains(fault.field)) << fault.field.to_string();
    broken[fault.field] = fault.value;
    const auto verdict = validator->Check(broken.dump());
    EXPECT_FALSE(verdict.valid) << fault.field.to_string();
    EXPECT_EQ(verdict.refused_by, std::set<std::string>{fault.refused_by}) << fault.field.to_string() << "\n" << verdict.said;
  }
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
