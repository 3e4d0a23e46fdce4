// Goal: a simulated sortie is what it claims to be: its geometry follows the telemetry conventions and the map to centimetres, its radiance
// is the truth through the stated point spread function, its errors have the stated sizes, and its bytes depend on the options only.
// Method: against closed forms (a plane and a sine wave have exact images), against the project's own camera model, by statistics with
// thresholds from a false alarm rate below 1e-6, and by comparing bytes.
#include "worker/simulate/simulation.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <numbers>
#include <string>

#include "mosaic/geometry/camera.h"
#include "mosaic/raster/crs.h"
#include "tests/support/paths.h"
#include "worker/simulate/flight.h"
#include "worker/simulate/records.h"
#include "worker/simulate/renderer.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using trem::testing::FileContents;
using trem::testing::TempDir;

constexpr double kRadPerDeg = std::numbers::pi / 180.0;

SimulationOptions SmallOptions() {
  SimulationOptions options;
  options.terrain_width_cells = 360;
  options.terrain_height_cells = 300;
  options.width_px = 48;
  options.height_px = 40;
  options.frame_count = 12;
  return options;
}

Truth PlacedTruth(const SimulationOptions& options, Image<float> grey) {
  Truth truth;
  truth.grey = std::move(grey);
  const Result<UtmFrame> frame = UtmFrame::ForPoint(options.origin_lat_deg, options.origin_lon_deg);
  TREM_CHECK(frame.ok());
  const Eigen::Vector2d centre = *frame->Forward(options.origin_lat_deg, options.origin_lon_deg);
  truth.grid.crs_wkt = frame->wkt();
  truth.grid.gsd = options.gsd_m / options.cells_per_pixel;
  truth.grid.width = truth.grey.width();
  truth.grid.height = truth.grey.height();
  truth.grid.origin_x = centre.x() - 0.5 * truth.grid.gsd * (truth.grey.width() - 1);
  truth.grid.origin_y = centre.y() + 0.5 * truth.grid.gsd * (truth.grey.height() - 1);
  return truth;
}

std::map<std::string, std::string> AllFiles(const fs::path& folder) {
  std::map<std::string, std::string> files;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    if (entry.is_regular_file()) files[fs::relative(entry.path(), folder).string()] = FileContents(entry.path());
  }
  return files;
}

TEST(SplineSurface, GoesThroughTheSamplesAndFollowsSmoothFunctionsBetweenThem) {
  Image<float> image(40, 30);
  const auto wave = [](double x, double y) { return 100.0 + 40.0 * std::sin(0.7 * x + 0.3) * std::cos(0.5 * y); };
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) image.at(x, y) = static_cast<float>(wave(x, y));
  }
  const SplineSurface surface(image);
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) ASSERT_NEAR(surface.At(x, y), image.at(x, y), 1e-4) << x << "," << y;
  }
  for (double y = 8.0; y < 22.0; y += 0.37) {
    for (double x = 8.0; x < 32.0; x += 0.41) ASSERT_NEAR(surface.At(x, y), wave(x, y), 0.05) << x << "," << y;
  }
}

TEST(Attitude, MatchesTheConventionsOfTelemetry) {
  // Looking down with the image's up to the north: right is east, bottom is south.
  const Eigen::Matrix3d down = RotationFromAttitude({0.0, -90.0 * kRadPerDeg, 0.0});
  EXPECT_TRUE(down.col(0).isApprox(Eigen::Vector3d(1, 0, 0), 1e-12));
  EXPECT_TRUE(down.col(1).isApprox(Eigen::Vector3d(0, -1, 0), 1e-12));
  // Looking east, 45 degrees down, then rolled clockwise: the right side of the camera turns downwards.
  const Eigen::Matrix3d east = RotationFromAttitude({90.0 * kRadPerDeg, -45.0 * kRadPerDeg, 10.0 * kRadPerDeg});
  EXPECT_TRUE(east.col(2).isApprox(Eigen::Vector3d(std::sqrt(0.5), 0, -std::sqrt(0.5)), 1e-12));
  EXPECT_LT(east(2, 0), 0.0);
  for (const double yaw : {0.0, 1.0, -2.5}) {
    for (const double pitch : {-1.5707, -1.2, -0.6}) {
      for (const double roll : {-3.0, 0.0, 0.2}) {
        const Eigen::Matrix3d rotation = RotationFromAttitude({yaw, pitch, roll});
        EXPECT_TRUE(rotation.isApprox(WorldFromCamera(yaw, pitch, roll), 1e-12));
        EXPECT_TRUE(RotationFromAttitude(AttitudeFromRotation(rotation)).isApprox(rotation, 1e-9));
      }
    }
  }
}

TEST(Flight, TrueTelemetryReproducesTheGroundPointsThroughTheProjectsCameraModel) {
  SimulationOptions options = SmallOptions();
  options.origin_lat_deg = 51.3;
  options.origin_lon_deg = -0.4;  // 2.6 degrees from the central meridian: convergence 2 degrees, scale not 0.9996.
  options.pitch_deg = -45.0;
  options.yaw_deg = 30.0;
  const Truth truth = PlacedTruth(options, Image<float>(900, 900, 0.0F));
  const Result<Flight> flight = PlanFlight(options, truth);
  ASSERT_TRUE(flight.ok()) << flight.status().message();
  const Result<UtmFrame> utm = UtmFrame::ForPoint(options.origin_lat_deg, options.origin_lon_deg);
  ASSERT_TRUE(utm.ok());
  for (const Exposure& exposure : flight->exposures) {
    const TelemetryRow& row = exposure.true_row;
    const double convergence = *utm->ConvergenceRad(row.latitude_deg, row.longitude_deg);
    const double scale = *utm->ScaleFactor(row.latitude_deg, row.longitude_deg);
    const Eigen::Vector2d place = *utm->Forward(row.latitude_deg, row.longitude_deg);
    const CameraPose pose{{0.0, 0.0, row.altitude_m}, row.attitude.yaw_rad, row.attitude.pitch_rad, row.attitude.roll_rad};
    const CameraIntrinsics intrinsics{options.width_px, options.height_px,
                                      FocalFromHorizontalFov(options.width_px, options.hfov_deg * kRadPerDeg)};
    for (const Eigen::Vector2d& u : {Eigen::Vector2d(0, 0), Eigen::Vector2d(47, 3), Eigen::Vector2d(20, 39)}) {
      const auto offset = IntersectGround(pose, intrinsics, options.ground_elevation_m, u);
      ASSERT_TRUE(offset.has_value());
      // A bearing from true north becomes one from grid north by taking the convergence away.
      const double c = std::cos(convergence), s = std::sin(convergence);
      const Eigen::Vector2d in_map = place + scale * Eigen::Vector2d(c * offset->x() - s * offset->y(), s * offset->x() + c * offset->y());
      const Eigen::Vector2d ground = GroundFromPixel(exposure.camera, flight->focal_px, options.width_px, options.height_px, u);
      EXPECT_LT((in_map - ground).norm(), 0.01) << "frame " << exposure.index;
      const Eigen::Vector2d back = PixelFromGround(exposure.camera, flight->focal_px, options.width_px, options.height_px, ground);
      EXPECT_LT((back - u).norm(), 1e-6);
    }
  }
}

TEST(Flight, HasTheGroundSampleDistanceAndTheErrorsThatWereAskedFor) {
  SimulationOptions options = SmallOptions();
  options.frame_count = 400;
  options.wander_deg = options.jitter_deg = options.position_wander_m = 0.0;
  options.gps_bias_m = 3.0;
  options.path = SimulatedPath::kDwell;
  const Truth truth = PlacedTruth(options, Image<float>(400, 400, 0.0F));
  const Result<Flight> flight = PlanFlight(options, truth);
  ASSERT_TRUE(flight.ok()) << flight.status().message();
  EXPECT_NEAR(flight->gps_bias_m.norm(), 3.0, 1e-12);
  const CameraState& camera = flight->exposures[0].camera;
  const Eigen::Vector2d a = GroundFromPixel(camera, flight->focal_px, 48, 40, {23.0, 19.5});
  const Eigen::Vector2d b = GroundFromPixel(camera, flight->focal_px, 48, 40, {24.0, 19.5});
  EXPECT_NEAR((b - a).norm(), options.gsd_m, 1e-5);

  const Result<UtmFrame> utm = UtmFrame::ForPoint(options.origin_lat_deg, options.origin_lon_deg);
  ASSERT_TRUE(utm.ok());
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  double squares = 0.0;
  double angle_squares = 0.0;
  for (const Exposure& exposure : flight->exposures) {
    const TelemetryRow& row = exposure.reported_row;
    const Eigen::Vector2d error = *utm->Forward(row.latitude_deg, row.longitude_deg) - exposure.camera.position_m - flight->gps_bias_m;
    const Eigen::Vector3d all(error.x(), error.y(), row.altitude_m - exposure.true_row.altitude_m);
    sum += all;
    squares += all.squaredNorm();
    const Eigen::Matrix3d turn = RotationFromAttitude(exposure.true_row.attitude).transpose() * RotationFromAttitude(row.attitude);
    angle_squares += std::pow(std::acos(std::min(1.0, 0.5 * (turn.trace() - 1.0))) / kRadPerDeg, 2);
  }
  // 1200 draws: the mean of an axis is within 5 sigma / sqrt(400), the root mean square within 12% (6 standard errors).
  EXPECT_LT((sum / 400.0).cwiseAbs().maxCoeff(), 5.0 * 0.1 / 20.0);
  EXPECT_NEAR(std::sqrt(squares / 1200.0), 0.1, 0.012);
  EXPECT_NEAR(std::sqrt(angle_squares / 1200.0), 0.05, 0.006);
}

TEST(Flight, EveryFootprintStaysInsideTheTruth) {
  for (const SimulatedPath path : {SimulatedPath::kLine, SimulatedPath::kLawnmower, SimulatedPath::kDwell}) {
    for (const double pitch_deg : {-90.0, -45.0}) {
      SimulationOptions options = SmallOptions();
      options.path = path;
      options.pitch_deg = pitch_deg;
      options.yaw_deg = 20.0;
      options.frame_count = 300;
      const Truth truth = PlacedTruth(options, Image<float>(900, 700, 0.0F));
      const Result<Flight> flight = PlanFlight(options, truth);
      ASSERT_TRUE(flight.ok()) << flight.status().message();
      for (const Exposure& exposure : flight->exposures) {
        for (const Eigen::Vector2d& u :
             {Eigen::Vector2d(-0.5, -0.5), Eigen::Vector2d(47.5, -0.5), Eigen::Vector2d(47.5, 39.5), Eigen::Vector2d(-0.5, 39.5)}) {
          const Eigen::Vector2d cell = truth.CellFromMap(GroundFromPixel(exposure.camera, flight->focal_px, 48, 40, u));
          ASSERT_TRUE(cell.x() >= 0.0 && cell.x() <= 899.0 && cell.y() >= 0.0 && cell.y() <= 699.0) << "frame " << exposure.index;
        }
      }
      EXPECT_LE(flight->speed_px, 4.0);
    }
  }
}

TEST(Renderer, GivesAWaveTheContrastThatThePointSpreadFunctionLeaves) {
  SimulationOptions options = SmallOptions();
  options.wander_deg = options.jitter_deg = options.position_wander_m = 0.0;
  Image<float> grey(400, 400);
  const double period_px = 2.5;  // Sensor pixels; 7.5 cells.
  for (int y = 0; y < 400; ++y) {
    for (int x = 0; x < 400; ++x)
      grey.at(x, y) = static_cast<float>(120.0 + 100.0 * std::sin(2.0 * std::numbers::pi * x / (3.0 * period_px)));
  }
  const Truth truth = PlacedTruth(options, std::move(grey));
  const Result<Flight> flight = PlanFlight(options, truth);
  ASSERT_TRUE(flight.ok());
  const Renderer renderer(options, truth, *flight, {});
  const Exposure& exposure = flight->exposures[3];
  const Image<double> radiance = renderer.Radiance(exposure);
  // Gaussian: exp(-2 (pi sigma f)^2); box: sinc(a f). Convergence turns the wave by less than a degree, which the exact ground point takes
  // in.
  const double f = 1.0 / period_px;
  const double transfer =
      std::exp(-2.0 * std::pow(std::numbers::pi * 0.6 * f, 2)) * std::sin(std::numbers::pi * 0.9 * f) / (std::numbers::pi * 0.9 * f);
  for (int y = 0; y < 40; ++y) {
    for (int x = 0; x < 48; ++x) {
      const double cell = truth.CellFromMap(GroundFromPixel(exposure.camera, flight->focal_px, 48, 40, {x * 1.0, y * 1.0})).x();
      ASSERT_NEAR(radiance.at(x, y), 120.0 + 100.0 * transfer * std::sin(2.0 * std::numbers::pi * cell / (3.0 * period_px)), 0.1)
          << x << "," << y;
    }
  }
}

TEST(Renderer, AddsNoiseDeadPixelsAndMoversAsAskedFor) {
  SimulationOptions options = SmallOptions();
  options.path = SimulatedPath::kDwell;
  options.noise_sigma = 3.0;
  options.bit_depth = 16;
  const Truth truth = PlacedTruth(options, Image<float>(400, 400, 100.0F));
  const Result<Flight> flight = PlanFlight(options, truth);
  ASSERT_TRUE(flight.ok());
  const Exposure& exposure = flight->exposures[0];
  const Image<std::uint16_t> frame = Renderer(options, truth, *flight, {}).Frame(exposure);
  double squares = 0.0;
  for (const std::uint16_t value : frame.pixels()) squares += std::pow(value / 256.0 - exposure.gain * 100.0 - exposure.offset, 2);
  // 1920 draws: the standard deviation's own error is 1.6%; six of them.
  EXPECT_NEAR(std::sqrt(squares / 1920.0), 3.0, 0.3);

  options.noise_sigma = 0.0;
  options.dead_pixel_fraction = 0.05;
  const Image<std::uint16_t> holes = Renderer(options, truth, *flight, {}).Frame(exposure);
  const auto normal = static_cast<int>(std::lround(256.0 * (exposure.gain * 100.0 + exposure.offset)));
  int dead = 0;
  for (const std::uint16_t value : holes.pixels()) dead += std::abs(value - normal) > 1 ? 1 : 0;
  EXPECT_NEAR(dead, 96, 60);  // Binomial: sigma 9.6.

  options.dead_pixel_fraction = 0.0;
  options.mover_count = 1;
  Mover mover;
  mover.start_m = GroundFromPixel(exposure.camera, flight->focal_px, 48, 40, {24.0, 20.0});
  mover.velocity_m_s = {1.0, 0.0};
  mover.turn_s = 1.0;
  mover.half_length_m = 4.0 * options.gsd_m;
  mover.half_width_m = 3.0 * options.gsd_m;
  mover.grey = 200.0;
  const Image<double> radiance = Renderer(options, truth, *flight, {mover}).Radiance(exposure);
  EXPECT_NEAR(radiance.at(24, 20), 200.0, 0.5);
  EXPECT_NEAR(radiance.at(34, 20), 100.0, 0.01);
}

TEST(Simulate, GivesTheSameBytesForAnyNumberOfThreadsAndOthersForAnotherSeed) {
  const TempDir temp;
  SimulationOptions options = SmallOptions();
  options.mover_count = 3;
  options.drop_fraction = 0.2;
  options.dead_pixel_fraction = 0.01;
  options.fixed_pattern_sigma = 1.0;
  options.thread_count = 1;
  ASSERT_TRUE(Simulate(options, temp / "one", {}).ok());
  options.thread_count = 4;
  ASSERT_TRUE(Simulate(options, temp / "four", {}).ok());
  EXPECT_EQ(AllFiles(temp / "one"), AllFiles(temp / "four"));
  options.seed = 2;
  ASSERT_TRUE(Simulate(options, temp / "other", {}).ok());
  EXPECT_NE(AllFiles(temp / "one")["frames/00000.png"], AllFiles(temp / "other")["frames/00000.png"]);
}

TEST(Simulate, RecordReadsBackAsItWasWrittenAndDroppedFramesLeaveNoTrace) {
  const TempDir temp;
  SimulationOptions options = SmallOptions();
  options.drop_fraction = 0.5;
  const Result<SimulationSummary> summary = Simulate(options, temp / "sortie", {});
  ASSERT_TRUE(summary.ok()) << summary.status().message();
  ASSERT_GT(summary->dropped_count, 0);
  const Result<SimulationRecord> record = ReadSimulation(temp / "sortie");
  ASSERT_TRUE(record.ok()) << record.status().message();
  EXPECT_EQ(static_cast<int>(record->flight.exposures.size()), summary->frame_count);
  const Truth truth = PlacedTruth(options, ProceduralTerrain(360, 300, options.seed));
  EXPECT_TRUE(std::ranges::equal(record->truth.grey.pixels(), truth.grey.pixels()));
  EXPECT_NEAR(record->truth.grid.origin_x, truth.grid.origin_x, 1e-6);
  EXPECT_NEAR(record->truth.grid.origin_y, truth.grid.origin_y, 1e-6);
  const Result<Flight> flight = PlanFlight(options, truth);
  ASSERT_TRUE(flight.ok());
  const std::string telemetry = FileContents(temp / "sortie" / "frames" / "telemetry.csv");
  for (const Exposure& exposure : flight->exposures) {
    EXPECT_EQ(telemetry.find(FrameName(exposure.index)) == std::string::npos, exposure.dropped);
    EXPECT_EQ(fs::exists(temp / "sortie" / "frames" / FrameName(exposure.index)), !exposure.dropped);
  }
  for (const Exposure& read : record->flight.exposures) {
    const Exposure& made = flight->exposures[static_cast<std::size_t>(read.index)];
    EXPECT_TRUE(read.camera.map_from_camera.isApprox(made.camera.map_from_camera, 1e-12));
    EXPECT_LT((read.camera.position_m - made.camera.position_m).norm(), 1e-5);
    EXPECT_NEAR(read.gain, made.gain, 1e-7);
  }
}

}  // namespace
}  // namespace trem
