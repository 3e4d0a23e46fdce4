// Goal: a recording with telemetry of its own ends in a mosaic that lies where that telemetry says. Method: `trem run` with real processes
// on the shared Fort A.P. Hill clip; the ground positions of the frames' corners in mosaic_chain.csv against the corners that the
// recording's KLV states (an independent computation of its producer). Both are averaged over the frames: the stated corners run 43 m to
// the west in the clip's 1.6 s while its picture stands still to a metre, so only their average can be right.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <iostream>
#include <sstream>

#include "mosaic/geometry/homography.h"
#include "mosaic/raster/crs.h"
#include "proto/trem/v1/task.pb.h"
#include "tests/e2e/run_fixture.h"
#include "worker/sortie/klv_telemetry.h"

namespace trem::testing {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

std::vector<std::string> Cells(const std::string& text) {
  std::vector<std::string> cells;
  std::istringstream line(text);
  for (std::string cell; std::getline(line, cell, ',');) cells.push_back(cell);
  return cells;
}

TEST(RecordedTelemetry, TheMosaicOfAKlvRecordingLiesWithinFiveMetresOfItsEmbeddedCorners) {
  const std::optional<fs::path> data = TestDataDir();
  if (!data) GTEST_SKIP() << "no sample data (../shared/data or TREM_TEST_DATA)";
  const RunFixture fixture;
  const fs::path out = fixture.NewFolder("out");
  const std::string recording = (*data / "fmv/aphill_short.ts").string();
  const Completed inspected =
      fixture.Run({BinaryPath("trem").string(), "inspect", recording, "--quiet", "--manifest", (out / "manifest.pb").string()});
  ASSERT_EQ(inspected.exit_code, 0) << inspected.stderr_text;
  EXPECT_THAT(inspected.stdout_text, HasSubstr("absolute sensor azimuth, grid north"));
  v1::SortieManifest manifest;
  ASSERT_TRUE(manifest.ParseFromString(FileContents(out / "manifest.pb")));
  const Completed run =
      fixture.Run({BinaryPath("trem").string(), "run", recording, "-o", (out / "mosaic.tif").string(), "--quiet", "--workers", "2"});
  ASSERT_EQ(run.exit_code, 0) << run.stderr_text;

  const UtmFrame map = UtmFrame::ForCrs("EPSG:32618").value();
  const std::vector<std::string> lines = Lines(FileContents(out / "mosaic_chain.csv"));
  const std::vector<std::string> header = Cells(lines.at(0));
  const auto first = static_cast<std::size_t>(std::find(header.begin(), header.end(), "world_from_sensor_11") - header.begin());
  ASSERT_EQ(header.at(first + 8), "world_from_sensor_33");
  const double right = manifest.width_px() - 0.5;
  const double bottom = manifest.height_px() - 0.5;
  const std::array<Eigen::Vector2d, 4> corners = {Eigen::Vector2d(-0.5, -0.5), Eigen::Vector2d(right, -0.5), Eigen::Vector2d(right, bottom),
                                                  Eigen::Vector2d(-0.5, bottom)};
  std::array<Eigen::Vector2d, 4> seen;
  std::array<Eigen::Vector2d, 4> stated;
  seen.fill(Eigen::Vector2d::Zero());
  stated.fill(Eigen::Vector2d::Zero());
  int compared = 0;
  for (std::size_t i = 1; i < lines.size(); ++i) {
    const std::vector<std::string> cells = Cells(lines[i]);
    if (cells.size() < first + 9 || cells[first].empty()) continue;
    Homography world_from_sensor;
    for (int k = 0; k < 9; ++k) world_from_sensor.matrix(k / 3, k % 3) = std::stod(cells[first + static_cast<std::size_t>(k)]);
    for (std::size_t k = 0; k < 4; ++k) seen[k] += world_from_sensor * corners[k];
    ++compared;
  }
  ASSERT_GE(compared, manifest.frames_size());
  const Result<KlvTelemetry> klv = ReadKlvTelemetry(recording);
  ASSERT_TRUE(klv.ok() && klv->chosen >= 0);
  const std::vector<TelemetryRecord>& records = klv->streams.at(klv->chosen).records;
  for (const TelemetryRecord& record : records) {
    ASSERT_TRUE(record.corners.has_value());
    for (std::size_t k = 0; k < 4; ++k)
      stated[k] += map.Forward((*record.corners)[k].latitude_deg, (*record.corners)[k].longitude_deg).value();
  }
  for (std::size_t k = 0; k < 4; ++k) {
    const double distance_m = (seen[k] / compared - stated[k] / static_cast<double>(records.size())).norm();
    std::cout << "corner " << k << " lies " << distance_m << " m from the embedded one, on average over " << compared
              << " frames and windows\n";
    EXPECT_LT(distance_m, 5.0);
  }
}

}  // namespace
}  // namespace trem::testing
