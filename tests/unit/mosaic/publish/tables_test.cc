// Goal: the text files stay well-formed whatever names and geometry a sortie brings. Method: hostile names; scenes that see the horizon.
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "mosaic/base/file.h"
#include "mosaic/publish/chain_csv.h"
#include "mosaic/publish/report.h"
#include "mosaic/publish/windows_geojson.h"
#include "mosaic/raster/crs.h"
#include "tests/support/paths.h"

namespace trem {
namespace {

TEST(ChainCsv, QuotesNamesAndKeepsEveryDigit) {
  const testing::TempDir folder;
  auto csv = ChainCsvWriter::Create(folder / "chain.csv");
  ASSERT_TRUE(csv.ok());
  ChainRow row;
  row.frame_index = 7;
  row.frame_name = "a \"b\", c\n.png";
  row.time_s = 0.1 + 0.2;
  row.window_id = 3;
  row.status = "registered";
  row.fit = ChainFit{};
  row.fit->gain = 1.0 / 3.0;
  ASSERT_TRUE(csv->Write(row).ok());
  ASSERT_TRUE(csv->Close().ok());
  const std::string text = *ReadFile(folder / "chain.csv", 1 << 20);
  EXPECT_NE(text.find("\n7,\"a \"\"b\"\", c\n.png\",0.30000000000000004,3,0,registered,,1,0,0,0,1,0,0,0,0.3333333333333333,0,0,0,0,,,,,,,,,\n"),
            std::string::npos)
      << text;
}

TEST(ChainCsv, AFolderThatIsMissingIsNamed) {
  const auto csv = ChainCsvWriter::Create("/no/such/folder/chain.csv");
  ASSERT_FALSE(csv.ok());
  EXPECT_NE(csv.status().message().find("/no/such/folder/chain.csv"), std::string::npos);
}

TEST(WindowsGeoJson, ASceneThatSeesTheHorizonDoesNotStopTheExport) {
  const testing::TempDir folder;
  SceneFootprint good;
  good.raster_in_scene = {0, 0, 100, 100};
  good.world_from_scene.matrix << 1.0, 0.0, 500000.0, 0.0, -1.0, 5000000.0, 0.0, 0.0, 1.0;
  SceneFootprint horizon = good;
  horizon.scene_id = 1;
  horizon.world_from_scene.matrix << 1.0, -5000.0, 500000.0, 1.0, -50001.0, 5000000.0, 0.0, -0.012, 1.0;
  const std::vector<SceneFootprint> scenes = {good, horizon};
  const Status status = WriteWindowsGeoJson(folder / "w.geojson", scenes, *CrsWkt("EPSG:32630"), true);
  ASSERT_TRUE(status.ok()) << status.message();
  const auto json = nlohmann::json::parse(*ReadFile(folder / "w.geojson", 1 << 20));
  EXPECT_EQ(json["features"][0]["geometry"]["type"], "Polygon");
  EXPECT_TRUE(json["features"][1]["geometry"].is_null());
  EXPECT_FALSE(json.contains("coordinates")) << "RFC 7946, 7.1 forbids it in a FeatureCollection";
}

TEST(Report, EscapesWhatComesFromOutside) {
  EXPECT_EQ(HtmlEscaped("<a href='x'>&\"\x01"), "&lt;a href=&#39;x&#39;&gt;&amp;&quot; ");
  ReportData data;
  data.sortie = "</title><script>alert(1)</script>";
  data.missing_frame_count = 100;
  data.missing_frames.push_back({"<img src=x>", "lost", "<b>"});
  data.notes.push_back({true, "<code>", "<subject>", "<message>"});
  data.median_nmad = std::nan("");
  const std::string html = *RenderReport(data);
  for (const char* unwanted : {"<script", "<img src=x", "<b><", "<code>", "<subject>", "<message>"}) {
    EXPECT_EQ(html.find(unwanted), std::string::npos) << unwanted;
  }
  EXPECT_NE(html.find("and 99 more"), std::string::npos);
  EXPECT_NE(html.find("not known grey levels"), std::string::npos);
}

}  // namespace
}  // namespace trem
