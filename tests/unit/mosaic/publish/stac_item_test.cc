// Goal: the STAC item says what a catalogue needs, with numbers that can be checked. Method: one item parsed back; the place against the
// projection's own inverse, the transform against the raster's, times against known dates. Whether the schemas accept it:
// tests/unit/worker/tasks/publish_tasks_test.cc.
#include "mosaic/publish/stac_item.h"

#include <gtest/gtest.h>

#include <limits>
#include <nlohmann/json.hpp>

#include "mosaic/raster/crs.h"
#include "mosaic/raster/geotiff.h"

namespace trem {
namespace {

StacItem Item() {
  StacItem item;
  item.id = "leg-1";
  item.title = "Leg 1";
  item.grid.crs_wkt = *CrsWkt("EPSG:32630");
  item.grid.origin_x = 500000.05;
  item.grid.origin_y = 4999999.95;
  item.grid.gsd = 0.1;
  item.grid.width = 900;
  item.grid.height = 600;
  item.georeferenced = true;
  item.software = "trem";
  item.version = "1.2.3";
  item.lineage = "made";
  item.assets.push_back({"mosaic.tif",
                         "mosaic",
                         "Mosaic",
                         "image/tiff",
                         {"data"},
                         std::string(64, 'a'),
                         1234,
                         {{"intensity", "", "float32", std::numeric_limits<double>::quiet_NaN()}},
                         {}});
  return item;
}

TEST(StacItem, TellsPlaceGridAndFiles) {
  const auto text = StacItemJson(Item());
  ASSERT_TRUE(text.ok()) << text.status().message();
  const auto json = nlohmann::json::parse(*text);
  EXPECT_EQ(json["type"], "Feature");
  EXPECT_EQ(json["properties"]["proj:epsg"], 32630);
  EXPECT_EQ(json["properties"]["proj:shape"], nlohmann::json({600, 900}));
  const std::vector<double> transform = json["properties"]["proj:transform"];
  ASSERT_EQ(transform.size(), 6u);
  const GeoTransform g = GeoTransformFromGrid(Item().grid);
  EXPECT_EQ(transform, (std::vector<double>{g[1], g[2], g[0], g[4], g[5], g[3]}));
  const auto lower_left = UtmFrame::ForCrs("EPSG:32630")->Inverse({500000.0, 4999940.0});
  EXPECT_NEAR(json["bbox"][0].get<double>(), lower_left->y(), 1e-6);
  EXPECT_NEAR(json["bbox"][1].get<double>(), lower_left->x(), 1e-6);
  EXPECT_EQ(json["geometry"]["coordinates"][0].front(), json["geometry"]["coordinates"][0].back());
  const auto& asset = json["assets"]["mosaic"];
  EXPECT_EQ(asset["href"], "./mosaic.tif");
  EXPECT_EQ(asset["file:checksum"], "1220" + std::string(64, 'a'));
  EXPECT_EQ(asset["file:size"], 1234);
  EXPECT_EQ(asset["raster:bands"][0]["nodata"], "nan");
  EXPECT_EQ(json["properties"]["processing:software"]["trem"], "1.2.3");
}

TEST(StacItem, HasNoPlaceWithoutTelemetry) {
  StacItem item = Item();
  item.georeferenced = false;
  item.grid.crs_wkt = LocalPixelCrsWkt();
  const auto text = StacItemJson(item);
  ASSERT_TRUE(text.ok()) << text.status().message();
  const auto json = nlohmann::json::parse(*text);
  EXPECT_TRUE(json["geometry"].is_null());
  EXPECT_FALSE(json.contains("bbox"));
  EXPECT_TRUE(json["properties"]["proj:epsg"].is_null());
}

TEST(StacItem, GivesTimesWhereTheyAreKnownAndSaysSoWhereNot) {
  StacItem item = Item();
  auto json = nlohmann::json::parse(*StacItemJson(item));
  EXPECT_EQ(json["properties"]["trem:datetime_known"], false);
  item.start_s = 1709208000.0;
  item.end_s = 1709208001.5;
  json = nlohmann::json::parse(*StacItemJson(item));
  EXPECT_EQ(json["properties"]["start_datetime"], "2024-02-29T12:00:00.000Z");
  EXPECT_EQ(json["properties"]["datetime"], "2024-02-29T12:00:00.750Z");
  EXPECT_EQ(json["properties"]["end_datetime"], "2024-02-29T12:00:01.500Z");
  EXPECT_FALSE(json["properties"].contains("trem:datetime_known"));
  EXPECT_EQ(Rfc3339(-0.0004), "1970-01-01T00:00:00.000Z");
}

}  // namespace
}  // namespace trem
