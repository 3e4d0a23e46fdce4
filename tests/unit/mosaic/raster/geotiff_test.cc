// Goal: the half pixel between this project's grids and GDAL's is right, once. Method: compare MosaicGrid's own map with the map that
// GDAL's documentation defines for its geotransform, and with what GDAL reads back from a file.
#include "mosaic/raster/geotiff.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "mosaic/base/file.h"
#include "mosaic/raster/crs.h"
#include "mosaic/raster/gdal_env.h"
#include "tests/support/paths.h"

namespace trem {
namespace {

MosaicGrid Grid() {
  MosaicGrid grid;
  grid.crs_wkt = *CrsWkt("EPSG:32630");
  grid.origin_x = 699321.25;
  grid.origin_y = 5634210.75;
  grid.gsd = 0.1;
  grid.width = 700;
  grid.height = 300;
  grid.tile_size = 256;
  return grid;
}

Eigen::Vector2d Apply(const double* g, double pixel, double line) {
  return {g[0] + pixel * g[1] + line * g[2], g[3] + pixel * g[4] + line * g[5]};
}

TEST(GeoTiff, ThePixelCentreIsWhereTheGridSaysAccordingToGdal) {
  const MosaicGrid grid = Grid();
  const GeoTransform g = GeoTransformFromGrid(grid);
  for (const auto& [column, row] : {std::pair{0, 0}, {699, 299}, {17, 203}}) {
    const Eigen::Vector2d expected = grid.WorldFromPixel({static_cast<double>(column), static_cast<double>(row)});
    EXPECT_LT((Apply(g.data(), column + 0.5, row + 0.5) - expected).norm(), 1e-8);
  }
}

TEST(GeoTiff, AnAffineGeoreferenceLeadsFromCornersToCorners) {
  const testing::TempDir folder;
  Affine target_from_pixel;
  target_from_pixel.linear << 0.31, -0.04, 0.05, 0.35;
  target_from_pixel.offset = {12.5, -3.25};
  FloatRaster raster;
  raster.bands.push_back({"value", Image<float>(20, 10, 1.0f)});
  raster.geotransform = GeoTransformFromAffine(target_from_pixel);
  ASSERT_TRUE(WriteFloatRaster(folder / "scene.tif", raster).ok());
  const GdalDatasetPtr dataset = *OpenTiff(folder / "scene.tif", "scene");
  double g[6];
  ASSERT_EQ(dataset->GetGeoTransform(g), CE_None);
  EXPECT_EQ(dataset->GetSpatialRef(), nullptr);
  for (const Eigen::Vector2d& pixel : {Eigen::Vector2d(0, 0), Eigen::Vector2d(19, 3), Eigen::Vector2d(4, 9)}) {
    const Eigen::Vector2d corner_based = target_from_pixel * pixel + Eigen::Vector2d(0.5, 0.5);
    EXPECT_LT((Apply(g, pixel.x() + 0.5, pixel.y() + 0.5) - corner_based).norm(), 1e-9);
  }
  // The identity is the identity in both conventions.
  EXPECT_EQ(GeoTransformFromAffine(Affine{}), (GeoTransform{0.0, 1.0, 0.0, 0.0, 0.0, 1.0}));
}

TEST(GeoTiff, FilesOfTilesTileThePlane) {
  const testing::TempDir folder;
  const MosaicGrid grid = Grid();
  for (int index = 0; index < grid.tile_count(); ++index) {
    const Roi roi = grid.TileRoi(index);
    FloatRaster raster;
    raster.bands.push_back({"value", Image<float>(roi.width(), roi.height(), 1.0f)});
    raster.grid = SubGrid(grid, roi);
    ASSERT_TRUE(WriteFloatRaster(folder / "tile.tif", raster).ok());
    const GdalDatasetPtr dataset = *OpenTiff(folder / "tile.tif", "tile");
    double g[6];
    ASSERT_EQ(dataset->GetGeoTransform(g), CE_None);
    const Eigen::Vector2d expected = grid.WorldFromPixel({static_cast<double>(roi.x0), static_cast<double>(roi.y0)});
    EXPECT_LT((Apply(g, 0.5, 0.5) - expected).norm(), 1e-6);
    ASSERT_NE(dataset->GetSpatialRef(), nullptr);
    EXPECT_STREQ(dataset->GetSpatialRef()->GetAuthorityCode(nullptr), "32630");
  }
}

TEST(GeoTiff, GridAndGeotransformAreInverses) {
  const MosaicGrid grid = Grid();
  const auto back = GridFromGeoTransform(GeoTransformFromGrid(grid), grid.width, grid.height);
  ASSERT_TRUE(back.ok());
  EXPECT_NEAR(back->origin_x, grid.origin_x, 1e-9);
  EXPECT_NEAR(back->origin_y, grid.origin_y, 1e-9);
  EXPECT_EQ(back->gsd, grid.gsd);
  EXPECT_FALSE(GridFromGeoTransform({0, 1, 0.1, 0, 0, -1}, 10, 10).ok()) << "a sheared raster is no grid";
  EXPECT_FALSE(GridFromGeoTransform({0, 1, 0, 0, 0, -2}, 10, 10).ok()) << "oblong pixels are no grid";
}

TEST(GeoTiff, BandsNodataAndMetadataComeBack) {
  const testing::TempDir folder;
  FloatRaster raster;
  raster.bands.push_back({"a", Image<float>(30, 20, 3.5f)});
  raster.bands.push_back({"b", Image<float>(30, 20, std::numeric_limits<float>::quiet_NaN())});
  raster.nodata = std::numeric_limits<double>::quiet_NaN();
  raster.metadata = {{"TREM_TILE_INDEX", "12"}};
  ASSERT_TRUE(WriteFloatRaster(folder / "x.tif", raster).ok());
  const auto info = InspectFloatRaster(folder / "x.tif");
  ASSERT_TRUE(info.ok());
  EXPECT_EQ(info->band_count, 2);
  EXPECT_EQ(info->metadata.at("TREM_TILE_INDEX"), "12");
  const auto bands = ReadFloatBands(folder / "x.tif", {1, 0}, Roi{5, 5, 7, 6}, 100);
  ASSERT_TRUE(bands.ok());
  EXPECT_TRUE(std::isnan((*bands)[0].at(1, 0)));
  EXPECT_EQ((*bands)[1].at(0, 0), 3.5f);
  EXPECT_EQ(ReadFloatBands(folder / "x.tif", {2}, std::nullopt, 1000).status().code(), StatusCode::kCorrupt);
}

TEST(GeoTiff, ABrokenCrsIsNamed) {
  const testing::TempDir folder;
  FloatRaster raster;
  raster.bands.push_back({"a", Image<float>(4, 4)});
  raster.grid = Grid();
  raster.grid->crs_wkt = "PROJCS[nonsense";
  const Status status = WriteFloatRaster(folder / "x.tif", raster);
  ASSERT_FALSE(status.ok());
  EXPECT_NE(status.message().find("PROJCS[nonsense"), std::string::npos) << status.message();
  EXPECT_FALSE(std::filesystem::exists(folder / "x.tif"));
}

TEST(GeoTiff, ALocalCrsSurvivesTheFile) {
  const testing::TempDir folder;
  FloatRaster raster;
  raster.bands.push_back({"a", Image<float>(4, 4)});
  raster.grid = Grid();
  raster.grid->crs_wkt = LocalPixelCrsWkt();
  ASSERT_TRUE(WriteFloatRaster(folder / "x.tif", raster).ok());
  const GdalDatasetPtr dataset = *OpenTiff(folder / "x.tif", "tile");
  ASSERT_NE(dataset->GetSpatialRef(), nullptr);
  EXPECT_TRUE(dataset->GetSpatialRef()->IsLocal());
}

}  // namespace
}  // namespace trem
