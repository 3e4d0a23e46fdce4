// Goal: the mosaic covers what was asked for, in the CRS and at the distance that were asked for, says when nothing is there, and comes
// with its comparison. Method: one simulated sortie, `trem run` with real processes, the results read back with GDAL's tools and as JSON.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "tests/e2e/run_fixture.h"

namespace trem::testing {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::Not;

class MosaicOptionsTest : public ::testing::Test {
 protected:
  void SetUp() override { sortie_ = fixture_.SimulateSortie("sortie", 24); }

  Completed Run(const fs::path& out, const std::vector<std::string>& options) const {
    return fixture_.Run(RunFixture::RunArguments(sortie_ / "sortie.textproto", out / "town.tif", options));
  }
  static nlohmann::json Json(const fs::path& path) { return nlohmann::json::parse(FileContents(path)); }
  std::string Info(const fs::path& raster) const { return fixture_.Run({"gdalinfo", "-stats", raster.string()}).stdout_text; }

  RunFixture fixture_;
  fs::path sortie_;
};

TEST_F(MosaicOptionsTest, TakesBoundsDistanceCutlineAndBaseline) {
  const fs::path first = fixture_.NewFolder("first");
  ASSERT_EQ(Run(first, {"--quiet"}).exit_code, 0);
  const nlohmann::json item = Json(first / "town.stac.json");
  EXPECT_EQ(item["assets"]["mosaic"]["href"], "./town.tif");
  EXPECT_EQ(item["assets"]["quality"]["href"], "./town_quality.tif");
  const std::vector<double> box = item["properties"]["proj:bbox"];
  const std::string report = FileContents(first / "town_report.html");
  EXPECT_THAT(report, HasSubstr("<h2>Times</h2>"));
  for (const char* expected : {"One frame, bicubic", "Baseline", "This mosaic", "Affine coefficients", "polyline"}) {
    EXPECT_THAT(report, HasSubstr(expected));
  }
  EXPECT_THAT(report, Not(HasSubstr("not available here")));

  const double x = 0.5 * (box[0] + box[2]), y = 0.5 * (box[1] + box[3]), half = 0.2 * std::min(box[2] - box[0], box[3] - box[1]);
  const std::vector<double> corners = item["bbox"];
  const double longitude = 0.5 * (corners[0] + corners[2]);
  const fs::path west = fixture_.folder() / "west.geojson";
  WriteFileContents(west, nlohmann::json({{"type", "Polygon"},
                                          {"coordinates",
                                           {{{corners[0] - 1, corners[1] - 1},
                                             {longitude, corners[1] - 1},
                                             {longitude, corners[3] + 1},
                                             {corners[0] - 1, corners[3] + 1},
                                             {corners[0] - 1, corners[1] - 1}}}}})
                              .dump());
  const fs::path second = fixture_.NewFolder("second");
  const auto text = [](double value) { return std::to_string(value); };
  const std::string bounds = text(x - half) + "," + text(y - half) + "," + text(x + half) + "," + text(y + half);
  const Completed cut = Run(second, {"--quiet", "--bounds", bounds, "--gsd", "0.2", "--cutline", west.string(), "--baseline", "--estimator",
                                     "biweight", "--set", "mosaic.compression=zstd"});
  ASSERT_EQ(cut.exit_code, 0) << cut.stderr_text;
  const nlohmann::json made = Json(second / "town.stac.json");
  EXPECT_NEAR(made["properties"]["proj:transform"][0].get<double>(), 0.2, 1e-12);
  const std::vector<double> got = made["properties"]["proj:bbox"];
  const double expected[] = {x - half, y - half, x + half, y + half};
  for (std::size_t i = 0; i < 4; ++i) EXPECT_NEAR(got[i], expected[i], 0.31) << i;
  EXPECT_THAT(Info(second / "town.tif"), HasSubstr("COMPRESSION=ZSTD"));
  // The cutline leaves about the western half: valid percentage of the statistics.
  const std::string info = Info(second / "town.tif");
  const std::size_t at = info.find("STATISTICS_VALID_PERCENT=");
  ASSERT_NE(at, std::string::npos) << info;
  EXPECT_NEAR(std::stod(info.substr(at + 25)), 50.0, 4.0);
  EXPECT_TRUE(fs::exists(second / "town_baseline.tif"));
  EXPECT_THAT(made["assets"]["baseline"]["proj:shape"].dump(), Not(HasSubstr("null")));
}

TEST_F(MosaicOptionsTest, AnUncoveredMosaicIsDoneInPart) {
  const fs::path first = fixture_.NewFolder("first");
  ASSERT_EQ(Run(first, {"--quiet"}).exit_code, 0);
  const std::vector<double> box = Json(first / "town.stac.json")["properties"]["proj:bbox"];
  // The outline's northernmost point is its upper left corner: the fixture lies east of its zone's central meridian.
  const std::vector<std::vector<double>> ring = Json(first / "town.stac.json")["geometry"]["coordinates"][0];
  std::vector<double> corner = ring[0];
  for (const std::vector<double>& point : ring) {
    if (point[1] > corner[1]) corner = point;
  }
  // A cutline of a few pixels there, which no turned scene fills.
  const fs::path sliver = fixture_.folder() / "sliver.geojson";
  const double e = 2e-6;
  WriteFileContents(sliver, nlohmann::json({{"type", "Polygon"},
                                            {"coordinates",
                                             {{{corner[0] + e, corner[1] - e},
                                               {corner[0] + 2 * e, corner[1] - e},
                                               {corner[0] + e, corner[1] - 2 * e},
                                               {corner[0] + e, corner[1] - e}}}}})
                                .dump());
  const fs::path second = fixture_.NewFolder("second");
  const Completed run =
      Run(second, {"--cutline", sliver.string(), "--json", "--quiet", "--bounds",
                   std::to_string(box[0]) + "," + std::to_string(box[1]) + "," + std::to_string(box[2]) + "," + std::to_string(box[3])});
  EXPECT_EQ(run.exit_code, 5) << run.stderr_text;
  const nlohmann::json report = nlohmann::json::parse(run.stdout_text);
  ASSERT_EQ(report["holes"].size(), 1U);
  EXPECT_EQ(report["state"], "done_in_part");
  EXPECT_EQ(report["exit_code"], 5);
  EXPECT_TRUE(fs::exists(second / "town.tif"));
  EXPECT_THAT(FileContents(second / "town_report.html"), HasSubstr("Do not rely on this mosaic"));
}

TEST_F(MosaicOptionsTest, RefusesWhatItCannotMeetBeforeAnythingIsComputed) {
  const auto refused = [&](const std::vector<std::string>& options, const std::string& named) {
    const fs::path out = fixture_.NewFolder("out");
    std::vector<std::string> all = {"--quiet", "--json"};
    all.insert(all.end(), options.begin(), options.end());
    const Completed run = Run(out, all);
    EXPECT_EQ(run.exit_code, 3) << run.stderr_text;
    EXPECT_THAT(run.stderr_text, HasSubstr(named));
    EXPECT_TRUE(NamesIn(out).empty());
    const nlohmann::json summary = nlohmann::json::parse(run.stdout_text);
    for (const auto& stage : summary["stages"]) {
      if (stage["kind"] == "enhance") {
        EXPECT_EQ(stage["done"], 0) << named;
      }
    }
    fs::remove_all(out);
  };
  refused({"--crs", "EPSG:999999"}, "EPSG:999999");
  refused({"--crs", "EPSG:4326"}, "geographic");
  refused({"--gsd", "-1"}, "mosaic.gsd");
  refused({"--bounds", "10,10,5,20"}, "mosaic.bounds");
  const fs::path points = fixture_.folder() / "points.geojson";
  WriteFileContents(points, R"({"type":"Point","coordinates":[1,2]})");
  refused({"--cutline", points.string()}, "points.geojson");
  refused({"--cutline", "missing.geojson"}, "missing.geojson");
}

}  // namespace
}  // namespace trem::testing
