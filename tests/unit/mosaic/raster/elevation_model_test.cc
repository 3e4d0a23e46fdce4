// Goal: an elevation model in any coordinate system is read where the sortie looks, and one that does not cover it, has no coordinate
// system or is no raster is refused by name. Method: a tilted plane written in UTM and in degrees, compared with its closed form.
#include "mosaic/raster/elevation_model.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "mosaic/raster/geotiff.h"
#include "tests/support/paths.h"

namespace trem {
namespace {

using ::testing::HasSubstr;

constexpr double kEast_m = 290000.0;
constexpr double kNorth_m = 4235000.0;

double PlaneAt(double east_m, double north_m) { return 80.0 + 0.02 * (east_m - kEast_m) - 0.01 * (north_m - kNorth_m); }

// 200 x 160 pixels of 10 m whose upper left centre is (kEast_m, kNorth_m) in UTM zone 18 N.
std::filesystem::path WriteUtm(const testing::TempDir& dir, bool with_crs = true, float hole = 0.0F) {
  FloatRaster raster;
  Image<float> z(200, 160);
  for (int r = 0; r < z.height(); ++r) {
    for (int c = 0; c < z.width(); ++c) z.at(c, r) = static_cast<float>(PlaneAt(kEast_m + 10.0 * c, kNorth_m - 10.0 * r));
  }
  if (hole != 0.0F) {
    for (float& value : z.pixels()) value = hole;
  }
  raster.bands.push_back({"elevation", z});
  if (hole != 0.0F) raster.nodata = hole;
  MosaicGrid grid;
  grid.crs_wkt = with_crs ? CrsWkt("EPSG:32618").value() : "";
  grid.origin_x = kEast_m;
  grid.origin_y = kNorth_m;
  grid.gsd = 10.0;
  grid.width = z.width();
  grid.height = z.height();
  if (with_crs) {
    raster.grid = grid;
  } else {
    raster.geotransform = GeoTransformFromGrid(grid);
  }
  const std::filesystem::path path = dir / "dem.tif";
  EXPECT_TRUE(WriteFloatRaster(path, raster).ok());
  return path;
}

GeographicBounds BoundsInside(const UtmFrame& map) {
  const Eigen::Vector2d a = map.Inverse({kEast_m + 400.0, kNorth_m - 1200.0}).value();
  const Eigen::Vector2d b = map.Inverse({kEast_m + 1500.0, kNorth_m - 300.0}).value();
  return {a.y(), a.x(), b.y(), b.x()};
}

TEST(ElevationModel, GivesTheElevationsOfAProjectedRasterAtLongitudesAndLatitudes) {
  const testing::TempDir dir;
  const UtmFrame map = UtmFrame::ForCrs("EPSG:32618").value();
  const GeographicBounds bounds = BoundsInside(map);
  const Result<GriddedGround> ground = ReadElevationModel(WriteUtm(dir), bounds);
  ASSERT_TRUE(ground.ok()) << ground.status().message();
  for (const double s : {0.0, 0.31, 0.77, 1.0}) {
    const double lon = bounds.west_deg + s * (bounds.east_deg - bounds.west_deg);
    const double lat = bounds.north_deg - s * (bounds.north_deg - bounds.south_deg);
    const Eigen::Vector2d x = map.Forward(lat, lon).value();
    ASSERT_TRUE(ground->ElevationAt({lon, lat}).has_value());
    EXPECT_NEAR(*ground->ElevationAt({lon, lat}), PlaneAt(x.x(), x.y()), 0.01);
  }
  const Result<GriddedGround> coarse = ReadElevationModel(WriteUtm(dir), bounds, 8);
  ASSERT_TRUE(coarse.ok());
  EXPECT_EQ(coarse->elevations_m().width(), 8);
  const double lon = 0.5 * (bounds.west_deg + bounds.east_deg);
  const double lat = 0.5 * (bounds.south_deg + bounds.north_deg);
  EXPECT_NEAR(*coarse->ElevationAt({lon, lat}), *ground->ElevationAt({lon, lat}), 0.5);
}

TEST(ElevationModel, IsCarriedIntoAWorkingWorld) {
  const testing::TempDir dir;
  const UtmFrame map = UtmFrame::ForCrs("EPSG:32618").value();
  const Result<GriddedGround> geographic = ReadElevationModel(WriteUtm(dir), BoundsInside(map));
  ASSERT_TRUE(geographic.ok());
  const Eigen::Vector2d origin(kEast_m + 900.0, kNorth_m - 700.0);
  const double scale = 0.9999;
  const Result<GriddedGround> world = GroundInWorld(*geographic, map, origin, scale);
  ASSERT_TRUE(world.ok()) << world.status().message();
  for (const Eigen::Vector2d& x : {Eigen::Vector2d(0.0, 0.0), Eigen::Vector2d(-300.0, 250.0), Eigen::Vector2d(410.0, -390.0)}) {
    ASSERT_TRUE(world->ElevationAt(x).has_value());
    const Eigen::Vector2d x_in_map = origin + scale * x;
    EXPECT_NEAR(*world->ElevationAt(x), PlaneAt(x_in_map.x(), x_in_map.y()), 0.02);
  }
}

TEST(ElevationModel, RefusesWhatDoesNotCoverTheSortieAndSaysWhatItCovers) {
  const testing::TempDir dir;
  const std::filesystem::path path = WriteUtm(dir);
  const auto far = ReadElevationModel(path, {10.0, 50.0, 10.01, 50.01});
  ASSERT_FALSE(far.ok());
  EXPECT_EQ(far.status().code(), StatusCode::kInvalidInput);
  EXPECT_THAT(far.status().message(), HasSubstr(path.string()));
  EXPECT_THAT(far.status().message(), HasSubstr("covers longitude -77.39956 to "));
  EXPECT_THAT(far.status().message(), HasSubstr("longitude 10.00000 to 10.01000"));
  const UtmFrame map = UtmFrame::ForCrs("EPSG:32618").value();
  const auto empty = ReadElevationModel(WriteUtm(dir, true, -9999.0F), BoundsInside(map));
  ASSERT_FALSE(empty.ok());
  EXPECT_THAT(empty.status().message(), HasSubstr("has no elevation within"));
}

TEST(ElevationModel, RefusesFilesWithoutACoordinateSystemOrWithoutARaster) {
  const testing::TempDir dir;
  const GeographicBounds bounds = BoundsInside(UtmFrame::ForCrs("EPSG:32618").value());
  const auto no_crs = ReadElevationModel(WriteUtm(dir, false), bounds);
  ASSERT_FALSE(no_crs.ok());
  EXPECT_THAT(no_crs.status().message(), HasSubstr("has no coordinate system"));
  testing::WriteFileContents(dir / "text.tif", "no raster");
  const auto text = ReadElevationModel(dir / "text.tif", bounds);
  ASSERT_FALSE(text.ok());
  EXPECT_THAT(text.status().message(), HasSubstr("text.tif: is no raster"));
  const auto gone = ReadElevationModel(dir / "gone.tif", bounds);
  ASSERT_FALSE(gone.ok());
  EXPECT_EQ(gone.status().code(), StatusCode::kNotFound);
}

}  // namespace
}  // namespace trem
