// Goal: what is published is a Cloud Optimized GeoTIFF by GDAL's own judgement, with the pixels that went in, and the same bytes each
// time. Method: write analytic tiles, read back, run GDAL's validator script and gdalinfo on the file.
#include "mosaic/raster/cog.h"

#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <limits>

#include "mosaic/base/file.h"
#include "mosaic/raster/crs.h"
#include "mosaic/raster/gdal_env.h"
#include "mosaic/raster/geotiff.h"
#include "tests/support/paths.h"
#include "tests/support/subprocess.h"

namespace trem {
namespace {

constexpr const char* kValidator = "/usr/lib/python3/dist-packages/osgeo_utils/samples/validate_cloud_optimized_geotiff.py";

const std::function<bool(double)> kGoOn = [](double) { return true; };

float Value(int x, int y) {
  const bool hole = (x - 300) * (x - 300) + (y - 200) * (y - 200) < 50 * 50;
  return hole ? std::numeric_limits<float>::quiet_NaN()
              : 100.0f + 20.0f * std::sin(0.05f * static_cast<float>(x) + 0.03f * static_cast<float>(y));
}

CogSpec Spec() {
  CogSpec spec;
  spec.grid.crs_wkt = *CrsWkt("EPSG:32630");
  spec.grid.origin_x = 500000.0;
  spec.grid.origin_y = 5000000.0;
  spec.grid.gsd = 0.25;
  spec.grid.width = 1500;
  spec.grid.height = 900;
  spec.grid.tile_size = 208;  // No multiple of the blocks.
  spec.bands = {"median"};
  spec.nodata = std::numeric_limits<double>::quiet_NaN();
  spec.metadata = {{"TREM_SORTIE", "a test"}};
  return spec;
}

CogTileReader Reader(const MosaicGrid& grid) {
  return [&grid](int index) -> Result<std::vector<Image<float>>> {
    const Roi roi = grid.TileRoi(index);
    Image<float> image(roi.width(), roi.height());
    for (int y = 0; y < roi.height(); ++y) {
      for (int x = 0; x < roi.width(); ++x) image.at(x, y) = Value(x + roi.x0, y + roi.y0);
    }
    return std::vector<Image<float>>{image};
  };
}

// Output of a program that must succeed.
std::string OutputOf(const std::vector<std::string>& argv) {
  testing::Subprocess process(argv);
  const auto exit = process.Wait(std::chrono::seconds(60));
  EXPECT_TRUE(exit && exit->code == 0) << argv[0] << ": " << process.Stdout() << process.Stderr();
  return process.Stdout();
}

TEST(Cog, PixelsOverviewsAndMetadataAreThere) {
  const testing::TempDir folder;
  const CogSpec spec = Spec();
  const Status status = WriteCog(folder / "mosaic.tif", spec, Reader(spec.grid), kGoOn);
  ASSERT_TRUE(status.ok()) << status.message();
  const auto bands = ReadFloatBands(folder / "mosaic.tif", {0}, std::nullopt, 1 << 24);
  ASSERT_TRUE(bands.ok()) << bands.status().message();
  for (int y = 0; y < spec.grid.height; ++y) {
    for (int x = 0; x < spec.grid.width; ++x) {
      const float found = (*bands)[0].at(x, y), expected = Value(x, y);
      ASSERT_EQ(std::isnan(found), std::isnan(expected)) << x << " " << y;
      if (std::isnan(expected)) continue;
      ASSERT_EQ(found, expected);
    }
  }
  const GdalDatasetPtr dataset = *OpenTiff(folder / "mosaic.tif", "mosaic");
  GDALRasterBand* band = dataset->GetRasterBand(1);
  EXPECT_EQ(band->GetOverviewCount(), 2);
  EXPECT_TRUE(std::isnan(band->GetNoDataValue()));
  EXPECT_STREQ(band->GetDescription(), "median");
  EXPECT_STREQ(dataset->GetMetadataItem("TREM_SORTIE"), "a test");
  EXPECT_FALSE(std::filesystem::exists(folder / "mosaic.tif.tiles.tif"));
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder.path()), {}), 1) << "something was left beside the mosaic";
}

TEST(Cog, PassesGdalsValidatorAndGdalinfo) {
  ASSERT_TRUE(std::filesystem::exists(kValidator)) << kValidator << " is missing: install python3-gdal (deploy/bootstrap.sh does)";
  const testing::TempDir folder;
  for (const CogSpec::Type type : {CogSpec::Type::kFloat32, CogSpec::Type::kInt32}) {
    CogSpec spec = Spec();
    spec.type = type;
    if (type == CogSpec::Type::kInt32) {
      spec.overviews = CogSpec::Overviews::kNearest;
      spec.nodata = -1.0;
    }
    const CogTileReader ids = [&](int index) -> Result<std::vector<Image<float>>> {
      const Roi roi = spec.grid.TileRoi(index);
      return std::vector<Image<float>>{Image<float>(roi.width(), roi.height(), static_cast<float>(index - 1))};
    };
    const Status status = WriteCog(folder / "mosaic.tif", spec, type == CogSpec::Type::kInt32 ? ids : Reader(spec.grid), kGoOn);
    ASSERT_TRUE(status.ok()) << status.message();
    const std::string verdict = OutputOf({"/usr/bin/python3", kValidator, (folder / "mosaic.tif").string()});
    EXPECT_NE(verdict.find("is a valid cloud optimized GeoTIFF"), std::string::npos) << verdict;
    EXPECT_EQ(verdict.find("warning"), std::string::npos) << verdict;
    const std::string info = OutputOf({"gdalinfo", "-checksum", (folder / "mosaic.tif").string()});
    EXPECT_NE(info.find("LAYOUT=COG"), std::string::npos) << info;
    EXPECT_NE(info.find("Block=512x512"), std::string::npos) << info;
    EXPECT_NE(info.find("Checksum="), std::string::npos) << info;
    EXPECT_NE(info.find("WGS 84 / UTM zone 30N"), std::string::npos) << info;
  }
}

TEST(Cog, TheSameTilesGiveTheSameBytes) {
  const testing::TempDir folder;
  const CogSpec spec = Spec();
  ASSERT_TRUE(WriteCog(folder / "a.tif", spec, Reader(spec.grid), kGoOn).ok());
  ASSERT_TRUE(WriteCog(folder / "b.tif", spec, Reader(spec.grid), kGoOn).ok());
  EXPECT_EQ(*ReadFile(folder / "a.tif", 1 << 26), *ReadFile(folder / "b.tif", 1 << 26));
}

TEST(Cog, AFailedOrStoppedWriteLeavesNothing) {
  const testing::TempDir folder;
  const CogSpec spec = Spec();
  const CogTileReader failing = [&](int index) -> Result<std::vector<Image<float>>> {
    if (index == 5) return Corrupt("tile 5 is broken");
    return Reader(spec.grid)(index);
  };
  EXPECT_EQ(WriteCog(folder / "mosaic.tif", spec, failing, kGoOn).code(), StatusCode::kCorrupt);
  for (const double stop_at : {0.2, 0.7}) {
    const auto stop = [stop_at](double fraction) { return fraction < stop_at; };
    EXPECT_EQ(WriteCog(folder / "mosaic.tif", spec, Reader(spec.grid), stop).code(), StatusCode::kCancelled);
  }
  EXPECT_TRUE(std::filesystem::is_empty(folder.path()));
  const Status nowhere = WriteCog(folder / "no/such/mosaic.tif", spec, Reader(spec.grid), kGoOn);
  EXPECT_NE(nowhere.message().find("no/such/mosaic.tif"), std::string::npos) << nowhere.message();
}

}  // namespace
}  // namespace trem
