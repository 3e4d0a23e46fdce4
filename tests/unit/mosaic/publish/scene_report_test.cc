// Goal: the report of `trem enhance` is one page that needs nothing else and holds everything it was given. Method: its text is searched.
#include "mosaic/publish/scene_report.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

namespace trem {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

TEST(SceneReport, IsOnePageWithoutReferencesAndHoldsEverything) {
  SceneReport report;
  report.title = "car<1>.tif";
  report.summary = "3 of 4 frames";
  report.notes = {"frame 2 lost: 40 % of the target are hidden"};
  report.numbers = {{"Noise", "2.1"}};
  report.pictures.push_back({{"PNGBYTES", {0.0, 2.0}}, "Residual", "grey levels", false});
  report.charts.push_back({"Gain", "frame", "", {{"gain", {0.0, 1.0}, {1.0, 1.1}}}});
  report.charts.push_back({"Nothing", "frame", "", {{"none", {0.0}, {std::nan("")}}}});
  report.files = {{"car.tif", "the scene"}};
  const std::string html = *RenderSceneReport(report);
  for (const char* part : {"<!DOCTYPE html>", "car&lt;1&gt;.tif", "3 of 4 frames", "40 % of the target", "UE5HQllURVM=", "alt=\"Gain\"",
                           "the scene", "</html>"}) {
    EXPECT_THAT(html, HasSubstr(part));
  }
  EXPECT_THAT(html, Not(HasSubstr("<script")));
  EXPECT_THAT(html, Not(HasSubstr("http")));
  EXPECT_THAT(html, Not(HasSubstr("Nothing"))) << "a chart without a value is left out";
  EXPECT_EQ(html, *RenderSceneReport(report));
}

}  // namespace
}  // namespace trem
