// Goal: a simulated sortie over hills, and its control points, are what they claim to be. Method: rays against the elevation model itself,
// heights against the bounds that were asked for, and the points' pixels against the true cameras.
#include "worker/simulate/relief.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <sstream>

#include "mosaic/raster/crs.h"
#include "tests/support/paths.h"
#include "worker/simulate/control_points.h"
#include "worker/simulate/flight.h"
#include "worker/simulate/records.h"
#include "worker/simulate/simulation.h"

namespace trem {
namespace {

using trem::testing::TempDir;

SimulationOptions HillyOptions() {
  SimulationOptions options;
  options.terrain_width_cells = 500;
  options.terrain_height_cells = 400;
  options.width_px = 48;
  options.height_px = 40;
  options.frame_count = 12;
  options.hfov_deg = 20.0;
  options.pitch_deg = -60.0;
  options.relief_m = 4.0;  // A tenth of the distance of 41 m.
  options.control_count = 4;
  return options;
}

class HillySortie : public ::testing::Test {
 protected:
  void SetUp() override {
    ASSERT_TRUE(Simulate(HillyOptions(), folder_ / "sortie", {}).ok());
    Result<SimulationRecord> record = ReadSimulation(folder_ / "sortie");
    ASSERT_TRUE(record.ok()) << record.status().message();
    record_ = std::move(record).value();
  }
  double Height(const Eigen::Vector2d& x) const { return record_.truth.relief->ElevationAt(x).value(); }

  TempDir folder_;
  SimulationRecord record_;
};

TEST_F(HillySortie, HasHillsOfTheAskedHeightUnderAllOfTheTruth) {
  ASSERT_NE(record_.truth.relief, nullptr);
  double low = 1e9, high = -1e9;
  for (int y = 0; y < 400; ++y) {
    for (int x = 0; x < 500; ++x) {
      const double z = Height(record_.truth.grid.WorldFromPixel({x * 1.0, y * 1.0}));
      low = std::min(low, z);
      high = std::max(high, z);
    }
  }
  EXPECT_GE(low, -2.001);
  EXPECT_LE(high, 2.001);
  EXPECT_GT(high - low, 3.6);
}

TEST_F(HillySortie, SeesEachPointWhereItsRayMeetsTheHills) {
  for (const Exposure& exposure : record_.flight.exposures) {
    const CameraState& camera = exposure.camera;
    for (const Eigen::Vector2d& u : {Eigen::Vector2d(0, 0), Eigen::Vector2d(47, 3), Eigen::Vector2d(20, 39)}) {
      const Eigen::Vector2d ground = GroundFromPixel(camera, record_.flight.focal_px, 48, 40, u);
      const Eigen::Vector3d ray((u.x() - 23.5) / record_.flight.focal_px, (u.y() - 19.5) / record_.flight.focal_px, 1.0);
      const Eigen::Vector2d offset_m = (ground - camera.position_m) / camera.map_scale;
      const Eigen::Vector3d to_ground(offset_m.x(), offset_m.y(), Height(ground) - camera.height_m);
      EXPECT_LT((to_ground.normalized() - (camera.map_from_camera * ray).normalized()).norm(), 1e-6);
      EXPECT_LT((PixelFromGround(camera, record_.flight.focal_px, 48, 40, ground) - u).norm(), 1e-3);
    }
  }
}

TEST_F(HillySortie, ListsControlPointsWhereTheTrueCamerasSeeThem) {
  const Result<UtmFrame> map = UtmFrame::ForPoint(51.0, -1.5);
  ASSERT_TRUE(map.ok());
  std::istringstream lines(trem::testing::FileContents(folder_ / "sortie" / "gcp.csv"));
  std::string line;
  std::getline(lines, line);
  EXPECT_EQ(line, "name,longitude_deg,latitude_deg,elevation_m,frame,x_px,y_px");
  int count = 0;
  double squares = 0.0;
  for (; std::getline(lines, line); ++count) {
    char name[8];
    double longitude = 0, latitude = 0, elevation = 0, x = 0, y = 0;
    int frame = 0;
    ASSERT_EQ(std::sscanf(line.c_str(), "%7[^,],%lf,%lf,%lf,%d.png,%lf,%lf", name, &longitude, &latitude, &elevation, &frame, &x, &y), 7) << line;
    const Eigen::Vector2d ground = *map->Forward(latitude, longitude);
    EXPECT_NEAR(elevation, 50.0 + Height(ground), 1e-3);
    const auto exposure = std::find_if(record_.flight.exposures.begin(), record_.flight.exposures.end(),
                                       [&](const Exposure& e) { return e.index == frame; });
    ASSERT_NE(exposure, record_.flight.exposures.end());
    squares += (PixelFromGround(exposure->camera, record_.flight.focal_px, 48, 40, ground) - Eigen::Vector2d(x, y)).squaredNorm();
  }
  EXPECT_GE(count, 8);
  // Noise of 0.2 px an axis; chance of leaving these bounds below 1e-6.
  EXPECT_LT(squares / (2 * count), 0.04 * 3.5);
  EXPECT_GT(squares / (2 * count), 0.04 * 0.05);
}

}  // namespace
}  // namespace trem
