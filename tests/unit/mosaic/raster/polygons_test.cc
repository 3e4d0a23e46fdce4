// Goal: polygons of users are read as they stand, or refused with the file's name and the reason. Method: small files, good and bad.
#include "mosaic/raster/polygons.h"

#include <gtest/gtest.h>

#include "mosaic/raster/crs.h"
#include "tests/support/paths.h"

namespace trem {
namespace {

using testing::TempDir;
using testing::WriteFileContents;

constexpr const char* kSquareWithHole =
    R"({"type":"FeatureCollection","features":[{"type":"Feature","properties":{},"geometry":{"type":"Polygon","coordinates":[
    [[-3,45],[-2.99,45],[-2.99,45.01],[-3,45.01],[-3,45]],[[-2.997,45.003],[-2.993,45.003],[-2.993,45.007],[-2.997,45.003]]]}},
    {"type":"Feature","properties":{},"geometry":{"type":"MultiPolygon","coordinates":[[[[-2.9,45],[-2.89,45],[-2.89,45.01],[-2.9,45]]]]}}]})";

class PolygonsTest : public ::testing::Test {
 protected:
  std::filesystem::path Write(const std::string& text, const char* name = "area.geojson") {
    WriteFileContents(folder_ / name, text);
    return folder_ / name;
  }
  std::string ErrorOf(const std::string& text) {
    const auto read = ReadPolygons(Write(text));
    EXPECT_FALSE(read.ok()) << text;
    if (read.ok()) return "";
    EXPECT_EQ(read.status().code(), StatusCode::kInvalidInput);
    EXPECT_NE(read.status().message().find("area.geojson"), std::string::npos) << read.status().message();
    return read.status().message();
  }
  TempDir folder_;
};

TEST_F(PolygonsTest, ReadsExteriorsHolesAndParts) {
  const auto polygons = ReadPolygons(Write(kSquareWithHole));
  ASSERT_TRUE(polygons.ok()) << polygons.status().message();
  ASSERT_EQ(polygons->rings.size(), 3u);
  EXPECT_EQ(polygons->rings[0].size(), 4u);
  EXPECT_EQ(polygons->rings[1].size(), 3u);
  EXPECT_DOUBLE_EQ(polygons->rings[0][1].x(), -2.99);
  EXPECT_DOUBLE_EQ(polygons->rings[0][2].y(), 45.01);
  EXPECT_EQ(EpsgOf(polygons->crs_wkt), 4326);
}

TEST_F(PolygonsTest, ReprojectsThemToTheMosaicsCrs) {
  const auto polygons = ReadPolygons(Write(kSquareWithHole));
  ASSERT_TRUE(polygons.ok());
  const auto projected = Reproject(*polygons, *CrsWkt("EPSG:32630"));
  ASSERT_TRUE(projected.ok()) << projected.status().message();
  const auto expected = UtmFrame::ForCrs("EPSG:32630")->Forward(45.0, -3.0);
  EXPECT_NEAR((projected->rings[0][0] - *expected).norm(), 0.0, 1e-3);
  EXPECT_EQ(projected->rings.size(), 3u);
}

TEST_F(PolygonsTest, NamesWhatIsWrong) {
  EXPECT_NE(ErrorOf("not json").find("GeoJSON"), std::string::npos);
  EXPECT_NE(ErrorOf(R"({"type":"FeatureCollection","features":[]})").find("no polygon"), std::string::npos);
  EXPECT_NE(ErrorOf(R"({"type":"Feature","properties":{},"geometry":{"type":"Point","coordinates":[1,2]}})").find("POINT"),
            std::string::npos);
  EXPECT_EQ(ReadPolygons(folder_ / "missing.geojson").status().code(), StatusCode::kNotFound);
}

}  // namespace
}  // namespace trem
