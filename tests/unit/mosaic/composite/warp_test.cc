// Goal: resampling puts the scene where the homography says, with a stated error, reports unseen ground as such and does not alias.
// Method: smooth analytic scenes, whose true value at every mosaic pixel is known.
#include "mosaic/composite/warp.h"

#include <gtest/gtest.h>

#include <cmath>

#include "mosaic/geometry/footprint.h"

namespace trem {
namespace {

// Periods of 12 and 15 cells: 4 to 5 sensor pixels at 3 cells a pixel, near the finest that a sensor shows.
double Wave(double u, double v) { return 100.0 + 40.0 * std::sin(2.0 * M_PI * u / 12.0) * std::cos(2.0 * M_PI * v / 15.0); }

SceneRaster MakeScene(const Roi& raster_in_scene, double (*function)(double, double)) {
  SceneRaster scene;
  scene.roi = {0, 0, raster_in_scene.width(), raster_in_scene.height()};
  scene.intensity = Image<float>(scene.roi.x1, scene.roi.y1);
  scene.information = Image<float>(scene.roi.x1, scene.roi.y1, 5.0f);
  for (int y = 0; y < scene.roi.y1; ++y) {
    for (int x = 0; x < scene.roi.x1; ++x) {
      scene.intensity.at(x, y) = static_cast<float>(function(raster_in_scene.x0 + x, raster_in_scene.y0 + y));
    }
  }
  return scene;
}

Homography Oblique() {
  Homography h;  // mosaic_from_scene: turned, sheared, with perspective.
  h.matrix << 0.9, -0.3, 60.0, 0.25, 0.8, -5.0, 4e-4, -3e-4, 1.0;
  return h;
}

TEST(Warp, ReproducesASmoothSceneUnderAHomography) {
  const Roi raster{-20, 10, 180, 190};
  const Homography mosaic_from_scene = *NormalisedAt(Oblique(), {80.0, 100.0});
  const Homography scene_from_mosaic = mosaic_from_scene.Inverse();
  const WarpSource source = *PrepareWarp(MakeScene(raster, Wave), raster);
  const WarpedScene warped = WarpScene(source, scene_from_mosaic, {-20, -20, 260, 260});
  int valid = 0;
  double worst = 0.0, square = 0.0;
  for (int y = 0; y < 280; ++y) {
    for (int x = 0; x < 280; ++x) {
      const float found = warped.intensity.at(x, y);
      if (std::isnan(found)) continue;
      const Eigen::Vector2d s = scene_from_mosaic * Eigen::Vector2d(x - 20, y - 20);
      const double error = found - Wave(s.x(), s.y());
      worst = std::max(worst, std::abs(error));
      square += error * error;
      ++valid;
      ASSERT_NEAR(warped.information.at(x, y), 5.0f, 1e-4f);
    }
  }
  // Area of the scene minus a border of 2 cells, over the cells a pixel takes.
  EXPECT_GT(valid, 15000);
  // The error falls with the cube of cells per period; at 12 and 15 cells it is about a hundredth of the amplitude of 40.
  EXPECT_LT(worst, 1.5);
  EXPECT_LT(std::sqrt(square / valid), 0.5);
}

// Relief: each place is read where the shifts have it, and vignetting is undone there.
TEST(Warp, ReadsShiftedCellsAndUndoesShade) {
  const Roi raster{0, 0, 200, 180};
  CellShifts shifts = CellShifts::Over({0.0, 0.0}, {199.0, 179.0}, 20.0, Eigen::Vector2d::Zero());
  CellGrid<double> shade = CellGrid<double>::Over({0.0, 0.0}, {199.0, 179.0}, 50.0, 1.0);
  for (int row = 0; row < shifts.rows; ++row) {
    for (int column = 0; column < shifts.columns; ++column) {
      const double x = column, y = row;
      shifts.values[static_cast<std::size_t>(row * shifts.columns + column)] = {2.0 * std::sin(x), 1.5 * std::cos(y + x)};
    }
  }
  for (std::size_t i = 0; i < shade.values.size(); ++i) shade.values[i] = 1.0 + 0.02 * static_cast<double>(i);
  const WarpSource source = *PrepareWarp(MakeScene(raster, Wave), raster);
  const WarpedScene warped = WarpScene(source, {Homography{}, shifts, shade}, {0, 0, 200, 180});
  double square = 0.0;
  int valid = 0;
  for (int y = 0; y < 180; ++y) {
    for (int x = 0; x < 200; ++x) {
      const float found = warped.intensity.at(x, y);
      if (std::isnan(found)) continue;
      const Eigen::Vector2d shown = Shifted(shifts, Eigen::Vector2d(x, y));
      const double error = found - shade.At(shown) * Wave(shown.x(), shown.y());
      square += error * error;
      ++valid;
    }
  }
  EXPECT_GT(valid, 32000);
  EXPECT_LT(std::sqrt(square / valid), 0.6);
}

TEST(CellGrid, UnshiftedIsTheInverseOfShifted) {
  CellShifts shifts = CellShifts::Over({-30.0, 5.0}, {90.0, 77.0}, 24.0, Eigen::Vector2d::Zero());
  for (std::size_t i = 0; i < shifts.values.size(); ++i)
    shifts.values[i] = {5.0 * std::sin(1.7 * static_cast<double>(i)), 4.0 * std::cos(static_cast<double>(i))};
  for (double x = -60.0; x < 120.0; x += 7.3) {
    const Eigen::Vector2d c(x, 0.6 * x + 10.0);
    EXPECT_LT((Shifted(shifts, Unshifted(shifts, c)) - c).norm(), 1e-5);
  }
  EXPECT_EQ(shifts.Node(0, 0), Eigen::Vector2d(-30.0, 5.0));
  EXPECT_GE(shifts.Node(shifts.columns - 1, 0).x(), 90.0);
}

TEST(Warp, IsExactOnCellCentresAndNeedsNoOtherCells) {
  const Roi raster{0, 0, 30, 20};
  SceneRaster scene = MakeScene(raster, Wave);
  const Image<float> original = scene.intensity;
  const WarpedScene warped = WarpScene(*PrepareWarp(std::move(scene), raster), Homography{}, {0, 0, 30, 20});
  for (int y = 0; y < 20; ++y) {
    for (int x = 0; x < 30; ++x) ASSERT_EQ(warped.intensity.at(x, y), original.at(x, y)) << x << " " << y;
  }
}

TEST(Warp, APixelWhoseKernelTouchesUnseenCellsIsInvalid) {
  const Roi raster{0, 0, 40, 40};
  SceneRaster scene = MakeScene(raster, Wave);
  scene.information.at(20, 20) = 0.0f;
  scene.intensity.at(20, 20) = 1e9f;  // Must not leak.
  scene.intensity.at(5, 30) = std::nanf("");
  Homography shifted;  // scene = mosaic + (0.5, 0.25)
  shifted.matrix(0, 2) = 0.5;
  shifted.matrix(1, 2) = 0.25;
  const WarpedScene warped = WarpScene(*PrepareWarp(std::move(scene), raster), shifted, {-5, -5, 45, 45});
  for (int y = -5; y < 45; ++y) {
    for (int x = -5; x < 45; ++x) {
      // The kernel at (x + 0.5, y + 0.25) covers the cells x - 1 .. x + 2, y - 1 .. y + 2.
      const auto touches = [&](int cx, int cy) { return cx >= x - 1 && cx <= x + 2 && cy >= y - 1 && cy <= y + 2; };
      const bool inside = x - 1 >= 0 && y - 1 >= 0 && x + 2 < 40 && y + 2 < 40;
      const bool expected = inside && !touches(20, 20) && !touches(5, 30);
      const float found = warped.intensity.at(x + 5, y + 5);
      ASSERT_EQ(!std::isnan(found), expected) << x << " " << y;
      if (!expected) continue;
      ASSERT_NEAR(found, Wave(x + 0.5, y + 0.25), 1.5);
    }
  }
}

TEST(Warp, BorderDistanceCountsCellsToTheNearestUnseenOne) {
  const Roi raster{100, 50, 121, 65};
  const WarpSource source = *PrepareWarp(MakeScene(raster, Wave), raster);
  EXPECT_FLOAT_EQ(source.border_distance.at(0, 7), 1.0f);
  EXPECT_FLOAT_EQ(source.border_distance.at(10, 7), 8.0f);
  EXPECT_FLOAT_EQ(source.border_distance.at(2, 7), 3.0f);
}

double FineChecks(double u, double) { return (static_cast<int>(u) & 1) != 0 ? 200.0 : 0.0; }

TEST(Warp, ACoarseMosaicAveragesInsteadOfAliasing) {
  // Stripes of one cell seen at 4 cells a pixel: plain cubic interpolation would show 0, 200 or a beat; the mean is 100.
  const Roi raster{0, 0, 400, 100};
  Homography coarse;
  coarse.matrix(0, 0) = 4.1;
  coarse.matrix(1, 1) = 4.1;
  coarse.matrix(0, 2) = 20.0;
  coarse.matrix(1, 2) = 20.0;
  const WarpedScene warped = WarpScene(*PrepareWarp(MakeScene(raster, FineChecks), raster), coarse, {0, 0, 85, 15});
  for (int y = 0; y < 15; ++y) {
    for (int x = 0; x < 85; ++x) ASSERT_NEAR(warped.intensity.at(x, y), 100.0f, 4.0f) << x << " " << y;
  }
}

TEST(Warp, NothingIsSeenBeyondTheHorizon) {
  const Roi raster{0, 0, 100, 100};
  Homography mosaic_from_scene;  // Horizon at v = 40: the rows above see no ground.
  mosaic_from_scene.matrix << 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -1.0 / 40.0, 1.0;
  const Homography placed = *NormalisedAt(mosaic_from_scene, {50.0, 80.0});
  const WarpSource source = *PrepareWarp(MakeScene(raster, Wave), raster);
  const WarpedScene warped = WarpScene(source, placed.Inverse(), {-400, -400, 400, 400});
  int valid = 0;
  for (int y = 0; y < 800; ++y) {
    for (int x = 0; x < 800; ++x) {
      if (std::isnan(warped.intensity.at(x, y))) continue;
      ++valid;
      const Eigen::Vector2d s = placed.Inverse() * Eigen::Vector2d(x - 400, y - 400);
      ASSERT_GT(s.y(), 40.0) << "a cell above the horizon was painted on the ground";
    }
  }
  EXPECT_GT(valid, 100);
}

TEST(Warp, APartWithItsMarginGivesTheSameBytesAsTheWhole) {
  const Roi raster{-30, 40, 370, 440};
  SceneRaster whole = MakeScene(raster, Wave);
  for (int i = 0; i < 400; i += 7) whole.information.at(i, (i * i + 11) % 400) = 0.0f;
  const Roi part{100, 90, 330, 310};  // Of the raster.
  SceneRaster cut;
  cut.roi = part;
  cut.intensity = Image<float>(part.width(), part.height());
  cut.information = Image<float>(part.width(), part.height());
  for (int y = 0; y < part.height(); ++y) {
    for (int x = 0; x < part.width(); ++x) {
      cut.intensity.at(x, y) = whole.intensity.at(x + part.x0, y + part.y0);
      cut.information.at(x, y) = whole.information.at(x + part.x0, y + part.y0);
    }
  }
  Homography shifted;
  shifted.matrix << 0.8, 0.1, 0.37, -0.1, 0.8, 0.21, 0.0, 0.0, 1.0;
  const Homography scene_from_mosaic = shifted.Inverse();
  const WarpSource a = *PrepareWarp(std::move(whole), raster);
  const WarpSource b = *PrepareWarp(std::move(cut), raster);
  const double distance = 10.0;
  const int margin = WarpMarginCells(distance);
  int compared = 0;
  const Roi roi{-50, -50, 400, 400};
  const WarpedScene wa = WarpScene(a, scene_from_mosaic, roi);
  const WarpedScene wb = WarpScene(b, scene_from_mosaic, roi);
  for (int y = roi.y0; y < roi.y1; ++y) {
    for (int x = roi.x0; x < roi.x1; ++x) {
      const Eigen::Vector2d s = scene_from_mosaic * Eigen::Vector2d(x, y) - Eigen::Vector2d(raster.x0, raster.y0);
      if (s.x() < part.x0 + margin || s.x() >= part.x1 - margin || s.y() < part.y0 + margin || s.y() >= part.y1 - margin) continue;
      const int column = x - roi.x0, row = y - roi.y0;
      const float ia = wa.intensity.at(column, row), ib = wb.intensity.at(column, row);
      ASSERT_EQ(std::isnan(ia), std::isnan(ib));
      if (std::isnan(ia)) continue;
      ASSERT_EQ(ia, ib);
      ASSERT_EQ(std::min(wa.border_distance.at(column, row), 10.0f), std::min(wb.border_distance.at(column, row), 10.0f));
      ++compared;
    }
  }
  EXPECT_GT(compared, 50);
}

}  // namespace
}  // namespace trem
