// Goal: what is fetched names its siblings as they are called and tells the job's times; nothing else changes. Method: small texts.
#include "coordinator/cli/published_text.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

namespace trem {
namespace {

TEST(PublishedText, TheStacItemNamesTheFilesAsTheyArePublished) {
  const std::string item =
      R"({"type":"Feature","assets":{"mosaic":{"href":"./mosaic.tif"},"quality":{"href":"./mosaic_quality.tif","a":1}}})";
  const auto finished = FinishedText("mosaic.stac.json", item, "/out/town.tif", {});
  ASSERT_TRUE(finished.ok()) << finished.status().message();
  const auto json = nlohmann::json::parse(*finished);
  EXPECT_EQ(json["assets"]["mosaic"]["href"], "./town.tif");
  EXPECT_EQ(json["assets"]["quality"]["href"], "./town_quality.tif");
  EXPECT_EQ(json["assets"]["quality"]["a"], 1);
  EXPECT_EQ(FinishedText("mosaic.stac.json", "[]", "/out/town.tif", {}).status().code(), StatusCode::kCorrupt);
}

TEST(PublishedText, TheReportGetsTheTimesOfTheStages) {
  v1::JobStatus job;
  v1::StageStatus* stage = job.add_stages();
  stage->set_kind(v1::ENHANCE);
  stage->set_total(4);
  stage->set_done(4);
  stage->set_elapsed_ms(10000);
  const auto finished = FinishedText("mosaic_report.html", "<p>a</p><!-- times --><p>b</p>", "/out/town.tif", job);
  ASSERT_TRUE(finished.ok());
  EXPECT_NE(finished->find("<td>enhance</td><td>4</td><td>10.0 s</td><td>2.50 s</td>"), std::string::npos) << *finished;
  EXPECT_EQ(finished->find("<!-- times -->"), std::string::npos);
  EXPECT_EQ(finished->find("<p>a</p>"), 0u);
}

TEST(PublishedText, LeavesTheOthersAlone) {
  EXPECT_FALSE(IsFinishedWhenPublished("mosaic.tif"));
  EXPECT_EQ(*FinishedText("mosaic_chain.csv", "<!-- times -->", "/out/town.tif", {}), "<!-- times -->");
}

}  // namespace
}  // namespace trem
