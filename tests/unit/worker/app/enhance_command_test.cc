// Goal: `trem enhance` does what its help says: the scene's geotransform leads to the reference frame's sensor pixels, the files
// appear together or not at all, and every bad input has its exit code and message. Method: the command function is called as main calls
// it, on frames rendered from a truth with one round bright spot; files are read back with GDAL.
#include "worker/app/enhance_command.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "mosaic/raster/gdal_env.h"
#include "mosaic/raster/geotiff.h"
#include "tests/support/paths.h"
#include "tests/support/rendered_sequence.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using trem::testing::FileContents;
using trem::testing::TempDir;

constexpr int kFrames = 10;
constexpr int kSide = 90;
const Eigen::Vector2d kSpotInTruth(201.3, 187.6);
constexpr double kFlatLevel = 90.0;
constexpr double kSpotRadius = 14.0;  // Cells around the spot that are counted to it.

struct Outcome {
  int code = -1;
  std::string out;
  std::string err;
};

Outcome RunCommand(std::vector<std::string> arguments) {
  arguments.insert(arguments.begin(), "trem enhance");
  std::vector<char*> argv;
  for (std::string& argument : arguments) argv.push_back(argument.data());
  ::testing::internal::CaptureStdout();
  ::testing::internal::CaptureStderr();
  Outcome outcome;
  outcome.code = RunEnhanceCommand(static_cast<int>(argv.size()), argv.data());
  outcome.out = ::testing::internal::GetCapturedStdout();
  outcome.err = ::testing::internal::GetCapturedStderr();
  return outcome;
}

// A bright spot on a flat yard in the middle of the usual ground.
Image<float> TruthWithASpot(const testing::SequenceOptions& options) {
  Image<float> truth = testing::ProceduralTruth(testing::TruthWidth(options), testing::TruthHeight(options), options.seed);
  for (int y = 0; y < truth.height(); ++y) {
    for (int x = 0; x < truth.width(); ++x) {
      const double d2 = (Eigen::Vector2d(x, y) - kSpotInTruth).squaredNorm();
      const double yard = kFlatLevel + 160.0 * std::exp(-0.5 * d2 / 16.0);
      truth.at(x, y) = d2 < 26.0 * 26.0 ? static_cast<float>(yard) : std::min(truth.at(x, y), 180.0F);
    }
  }
  return truth;
}

// Mean over 7 x 7 cells; NaN (never seen) when one of them is.
double MeanAround(const Image<float>& scene, int x, int y) {
  double sum = 0.0;
  for (int j = -3; j <= 3; ++j) {
    for (int i = -3; i <= 3; ++i) sum += scene.at(x + i, y + j);
  }
  return sum / 49.0;
}

// Centroid of the spot [pixels of the scene, centre-based], from the brightest surroundings on.
Eigen::Vector2d FindSpot(const Image<float>& scene) {
  Eigen::Vector2d centre(0, 0);
  double brightest = 0.0;
  for (int y = 3; y + 3 < scene.height(); ++y) {
    for (int x = 3; x + 3 < scene.width(); ++x) {
      const double mean = MeanAround(scene, x, y);
      if (!(mean > brightest)) continue;
      brightest = mean;
      centre = {x, y};
    }
  }
  for (int iteration = 0; iteration < 10; ++iteration) {
    Eigen::Vector2d sum(0, 0);
    double weight = 0.0;
    for (int y = 0; y < scene.height(); ++y) {
      for (int x = 0; x < scene.width(); ++x) {
        const double above = scene.at(x, y) - kFlatLevel;
        if (!(above > 10.0) || (Eigen::Vector2d(x, y) - centre).norm() > kSpotRadius) continue;
        sum += above * Eigen::Vector2d(x, y);
        weight += above;
      }
    }
    centre = sum / weight;
  }
  return centre;
}

class EnhanceCommand : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = std::make_unique<TempDir>();
    testing::SequenceOptions options;
    options.frame_count = kFrames;
    options.roi_px = kSide;
    options.speed_px = 1.3;
    options.gain_swing = 0.0;
    options.offset_swing = 0.0;
    const testing::RenderedSequence sequence = testing::RenderSequence(TruthWithASpot(options), options);
    views_ = sequence.truth_from_sensor;
    fs::create_directory(*folder_ / "frames");
    for (int t = 0; t < kFrames; ++t) {
      cv::Mat1b grey(kSide, kSide);
      for (int y = 0; y < kSide; ++y) {
        for (int x = 0; x < kSide; ++x) {
          grey(y, x) = cv::saturate_cast<unsigned char>(sequence.frames[static_cast<std::size_t>(t)].pixels.at(x, y));
        }
      }
      ASSERT_TRUE(cv::imwrite((*folder_ / "frames" / ("f" + std::to_string(100 + t) + ".png")).string(), grey));
    }
  }
  static void TearDownTestSuite() { folder_.reset(); }

  // The scene's geotransform leads from the spot to where frame `index` saw it, and its metadata name that frame.
  static void ExpectSpotAtItsPlaceInFrame(int index, const std::string& path) {
    const Result<std::vector<Image<float>>> bands = ReadFloatBands(path, {0}, {}, 1'000'000);
    ASSERT_TRUE(bands.ok()) << bands.status().message();
    const GdalDatasetPtr dataset = *OpenTiff(path, "scene");
    EXPECT_EQ(std::string(dataset->GetMetadataItem("REFERENCE_FRAME")), "f10" + std::to_string(index) + ".png");
    EXPECT_EQ(std::string(dataset->GetMetadataItem("REFERENCE_FRAME_INDEX")), std::to_string(index));
    double g[6];
    ASSERT_EQ(dataset->GetGeoTransform(g), CE_None);
    const Eigen::Vector2d found = FindSpot((*bands)[0]);
    const double pixel = found.x() + 0.5;
    const double line = found.y() + 0.5;
    const Eigen::Vector2d corner_based(g[0] + pixel * g[1] + line * g[2], g[3] + pixel * g[4] + line * g[5]);
    const Eigen::Vector2d expected = views_[static_cast<std::size_t>(index)].Inverse() * kSpotInTruth + Eigen::Vector2d(0.5, 0.5);
    EXPECT_LT((corner_based - expected).norm(), 0.1) << corner_based.transpose() << " for " << expected.transpose();
  }

  static std::string Frames() { return (*folder_ / "frames").string(); }
  static std::unique_ptr<TempDir> folder_;
  static std::vector<Affine> views_;
};

std::unique_ptr<TempDir> EnhanceCommand::folder_;
std::vector<Affine> EnhanceCommand::views_;

TEST_F(EnhanceCommand, TheGeotransformLeadsToSensorPixelsOfTheReferenceFrame) {
  const TempDir temp;
  const std::string output = (temp / "scene.tif").string();
  // A corner that is not the origin, sides that differ, and a frame that is neither the first nor the last.
  const Outcome outcome = RunCommand({Frames(), "--roi", "5,8,78,74", "--reference", "6", "-o", output});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  ExpectSpotAtItsPlaceInFrame(6, output);
  // Grey levels are the source's.
  const std::vector<Image<float>> bands = *ReadFloatBands(output, {0}, {}, 1'000'000);
  const Eigen::Vector2d found = FindSpot(bands[0]);
  EXPECT_NEAR(bands[0].at(static_cast<int>(found.x() + 19), static_cast<int>(found.y())), kFlatLevel, 6.0);
}

TEST_F(EnhanceCommand, ATargetIsFollowedBothWaysAndItsSceneLeadsToTheFrameItWasPickedIn) {
  const TempDir temp;
  const std::string output = (temp / "target.tif").string();
  const Eigen::Vector2d spot = views_[4].Inverse() * kSpotInTruth;
  const std::string roi = std::to_string(std::lround(spot.x()) - 22) + "," + std::to_string(std::lround(spot.y()) - 20) + ",44,41";
  const Outcome outcome = RunCommand({Frames(), "--roi", roi, "--track", "--reference", "4", "--json", "-o", output});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_THAT(outcome.out, HasSubstr("\"registered\": 10"));
  EXPECT_THAT(outcome.out, HasSubstr("\"target\": true"));
  ExpectSpotAtItsPlaceInFrame(4, output);
  EXPECT_THAT(FileContents(temp / "target_chain.csv"), HasSubstr("\n4,f104.png,started_scene,"));
  EXPECT_THAT(FileContents(temp / "target_chain.csv"), HasSubstr("\n0,f100.png,registered,"));
  EXPECT_THAT(FileContents(temp / "target_report.html"), HasSubstr("Place of the target in the sensor"));
}

TEST_F(EnhanceCommand, TheSceneHasItsStandardDeviationInformationAndResidual) {
  const TempDir temp;
  const std::string output = (temp / "scene.tif").string();
  ASSERT_EQ(RunCommand({Frames(), "-q", "-o", output}).code, 0);
  const Result<std::vector<Image<float>>> bands = ReadFloatBands(output, {0, 1, 2, 3}, {}, 1'000'000);
  ASSERT_TRUE(bands.ok()) << bands.status().message();
  long long seen = 0;
  for (std::size_t i = 0; i < (*bands)[0].pixels().size(); ++i) {
    const bool known = (*bands)[2].pixels()[i] > 0.0F;
    seen += known ? 1 : 0;
    for (const std::size_t band : {0U, 1U, 3U})
      ASSERT_EQ(std::isfinite((*bands)[band].pixels()[i]), known) << "band " << band << " at " << i;
    if (!known) continue;
    ASSERT_GT((*bands)[1].pixels()[i], 0.0F);
    ASSERT_LT((*bands)[1].pixels()[i], 128.0F);
  }
  EXPECT_GT(seen, 9 * 80 * 80);
  const std::string csv = FileContents(temp / "scene_chain.csv");
  const std::string header = csv.substr(0, csv.find('\n'));
  EXPECT_THAT(header, HasSubstr(",cov_ulx_ulx,cov_ulx_uly,"));
  EXPECT_THAT(header, ::testing::EndsWith(",cov_lly_lly"));
  for (std::size_t at = 0; at < csv.size();) {
    const std::size_t end = csv.find('\n', at);
    EXPECT_EQ(std::count(csv.begin() + static_cast<std::ptrdiff_t>(at), csv.begin() + static_cast<std::ptrdiff_t>(end), ','),
              std::count(header.begin(), header.end(), ','));
    at = end + 1;
  }
}

TEST_F(EnhanceCommand, LeavesFourFilesNamedAfterTheOutput) {
  const TempDir temp;
  const Outcome outcome = RunCommand({Frames(), "--frames", "2:8", "--json", "-o", (temp / "yard.tif").string()});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  EXPECT_THAT(outcome.out, HasSubstr("\"registered\": 6"));
  const std::string csv = FileContents(temp / "yard_chain.csv");
  EXPECT_THAT(csv, HasSubstr("\n2,f102.png,started_scene,,0,"));
  EXPECT_THAT(csv, HasSubstr("\n7,f107.png,registered,,0,"));
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), 7);
  const cv::Mat picture = cv::imread((temp / "yard_comparison.png").string(), cv::IMREAD_UNCHANGED);
  ASSERT_FALSE(picture.empty());
  EXPECT_EQ(picture.rows, 3 * kSide);
  EXPECT_GT(picture.cols, 2 * 3 * kSide);
  std::size_t files = 0;
  for (const auto& entry : fs::directory_iterator(temp.path())) files += entry.is_regular_file() ? 1 : 0;
  EXPECT_EQ(files, 4U) << "nothing temporary stays";
}

TEST_F(EnhanceCommand, TheResolutionIsMeasuredAgainstTheNumberOfFramesUnlessItIsNotAskedFor) {
  const TempDir temp;
  const Outcome outcome = RunCommand({Frames(), "--json", "-q", "-o", (temp / "a.tif").string()});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  const auto points = nlohmann::json::parse(outcome.out)["resolution"];
  ASSERT_EQ(points.size(), 2U) << "of 4 and of 10 frames";
  EXPECT_EQ(points[0]["frames"], 4);
  EXPECT_EQ(points[1]["frames"], 10);
  for (const auto& point : points) {
    EXPECT_GT(point["cycles_per_px"], 0.4);
    EXPECT_LT(point["cycles_per_px"], 1.2);
  }
  EXPECT_GT(points[1]["cycles_per_px"], points[0]["cycles_per_px"]);
  EXPECT_THAT(FileContents(temp / "a_report.html"), HasSubstr("Resolution, 10 frames"));

  const Outcome without = RunCommand({Frames(), "--resolution-frames", "0", "--json", "-q", "-o", (temp / "b.tif").string()});
  ASSERT_EQ(without.code, 0) << without.err;
  EXPECT_TRUE(nlohmann::json::parse(without.out)["resolution"].empty());
  EXPECT_EQ(FileContents(temp / "a.tif"), FileContents(temp / "b.tif"));
}

TEST_F(EnhanceCommand, TheNumberOfThreadsChangesNoByte) {
  const TempDir temp;
  for (const std::string& threads : {std::string("1"), std::string("3")}) {
    const Outcome outcome = RunCommand({Frames(), "--threads", threads, "-q", "-o", (temp / ("by" + threads + ".tif")).string()});
    ASSERT_EQ(outcome.code, 0) << outcome.err;
  }
  for (const char* const file : {".tif", "_chain.csv", "_comparison.png"}) {
    EXPECT_TRUE(FileContents(temp / (std::string("by1") + file)) == FileContents(temp / (std::string("by3") + file))) << file;
  }
}

TEST_F(EnhanceCommand, BadInputHasItsCodeAndMessageAndLeavesNothing) {
  const struct {
    std::vector<std::string> more;
    int code;
    const char* message;
  } cases[] = {
      {{"--track"}, 2, "--track requires --roi"},
      {{"--track", "--roi", "40,40,60,60"}, 3, "is not inside the frames, which are 90 x 90 pixels"},
      {{"--track", "--roi", "0,0,15,40"}, 3, "expected sides of 16 to 1024"},
      {{"--track", "--roi", "20,20,40,40", "--frames", "2:6", "--reference", "6"}, 3, "picked in one of the frames used, 2:6"},
      {{"--track", "--roi", "20,20,40,40", "--reference", "10"}, 3, "picked in one of the frames used, 0:10"},
      {{"--roi", "1,2,3"}, 2, "expected x,y,width,height"},
      {{"--roi", "1,2,30,40,"}, 2, "expected x,y,width,height"},
      {{"--roi", "-1,2,30,40"}, 2, "expected x,y,width,height"},
      {{"--roi", "1,2,99999999999,40"}, 2, "expected x,y,width,height"},
      {{"--roi", "40,40,60,60"}, 3, "is not inside the frames, which are 90 x 90 pixels"},
      {{"--roi", "0,0,15,40"}, 3, "is 15 x 40 sensor pixels; expected sides of 16 to 1024"},
      {{"--threads", "-1"}, 2, "--threads"},
      {{"--threads", "1025"}, 2, "--threads"},
      {{"--frames", "7"}, 2, "expected first:end"},
      {{"--frames", "7:x"}, 2, "expected first:end"},
      {{"--frames", "7:7"}, 2, "expected first:end"},
      {{"--frames", "5:11"}, 3, "has 10 frames"},
      {{"--frames", "0:5000"}, 3, "choose at most 4096"},
      {{"--frames", "2:6", "--reference", "1"}, 3, "choose one of 2-5"},
      {{"--set", "tre.ratio=9"}, 3, "tre.ratio"},
  };
  for (const auto& bad : cases) {
    const TempDir temp;
    std::vector<std::string> arguments = {Frames(), "-o", (temp / "scene.tif").string()};
    arguments.insert(arguments.end(), bad.more.begin(), bad.more.end());
    const Outcome outcome = RunCommand(arguments);
    EXPECT_EQ(outcome.code, bad.code) << bad.message;
    EXPECT_THAT(outcome.err, HasSubstr(bad.message));
    EXPECT_TRUE(fs::is_empty(temp.path())) << bad.message;
  }
}

TEST_F(EnhanceCommand, SaysWhatIsWrongWithTheSortieOrTheOutput) {
  const TempDir temp;
  const Outcome missing = RunCommand({(temp / "missing").string(), "-o", (temp / "scene.tif").string()});
  EXPECT_EQ(missing.code, 3);
  EXPECT_THAT(missing.err, HasSubstr("missing"));
  const Outcome no_folder = RunCommand({Frames(), "-o", (temp / "nowhere" / "scene.tif").string()});
  EXPECT_EQ(no_folder.code, 3);
  EXPECT_THAT(no_folder.err, HasSubstr("nowhere"));
  const Outcome no_tiff = RunCommand({Frames(), "-o", (temp / "scene.png").string()});
  EXPECT_EQ(no_tiff.code, 3);
  EXPECT_THAT(no_tiff.err, HasSubstr("ends in .tif"));
  EXPECT_EQ(RunCommand({}).code, 2);
  EXPECT_EQ(RunCommand({"--help"}).code, 0);
}

}  // namespace
}  // namespace trem
