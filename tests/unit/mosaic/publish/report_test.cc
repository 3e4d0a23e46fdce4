// Goal: the report judges by its stated bounds and draws what it is given where it lies. Method: data on either side of each bound; the
// map's numbers read back from the page.
#include "mosaic/publish/report.h"

#include <gtest/gtest.h>

#include <limits>

#include "mosaic/publish/report_map.h"

namespace trem {
namespace {

using Verdict = ReportCheck::Verdict;

ReportData GoodData() {
  ReportData data;
  data.sortie = "leg";
  data.georeferenced = true;
  data.width = 800;
  data.height = 400;
  data.gsd = 0.25;
  data.frame_count = 100;
  data.registered_count = 99;
  data.piece_count = 1;
  data.tie_rms_px = 0.1;
  data.median_scenes = 5.0;
  data.median_nmad = 1.0;
  data.grey_range = 200.0;
  data.median_position_sigma = 0.4;
  return data;
}

Verdict Of(const ReportData& data, const std::string& name) {
  for (const ReportCheck& check : JudgeMosaic(data)) {
    if (check.name == name) return check.verdict;
  }
  ADD_FAILURE() << "no check " << name;
  return Verdict::kGood;
}

TEST(Report, JudgesByTheBoundsThatItStates) {
  ReportData data = GoodData();
  for (const ReportCheck& check : JudgeMosaic(data)) EXPECT_EQ(check.verdict, Verdict::kGood) << check.name;
  data.registered_count = 90;
  EXPECT_EQ(Of(data, "Frames registered"), Verdict::kLook);
  data.registered_count = 79;
  EXPECT_EQ(Of(data, "Frames registered"), Verdict::kBad);
  data.tie_rms_px = 0.36;
  EXPECT_EQ(Of(data, "How well frames and scenes agree"), Verdict::kLook);
  data.tie_rms_px = 1.1;
  EXPECT_EQ(Of(data, "How well frames and scenes agree"), Verdict::kBad);
  data.median_scenes = 1.0;  // One window over a camera that dwells: each pixel of many frames, but of one scene.
  EXPECT_EQ(Of(data, "Scenes over a pixel"), Verdict::kLook);
  data.median_scenes = 0.0;
  EXPECT_EQ(Of(data, "Scenes over a pixel"), Verdict::kBad);
  data.median_nmad = 11.0;
  EXPECT_EQ(Of(data, "Spread between scenes"), Verdict::kBad);
  data.median_nmad = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(Of(data, "Spread between scenes"), Verdict::kLook);
  data.piece_count = 2;
  EXPECT_EQ(Of(data, "Connected pieces"), Verdict::kLook);
  data.hole_count = 1;
  EXPECT_EQ(Of(data, "Parts that failed"), Verdict::kBad);
  data.georeferenced = false;
  EXPECT_EQ(Of(data, "Place on Earth"), Verdict::kLook);
}

TEST(Report, SaysInOneSentenceWhetherToTrustTheMosaic) {
  ReportData data = GoodData();
  EXPECT_NE(RenderReport(data)->find("Nothing that was measured speaks against this mosaic"), std::string::npos);
  data.piece_count = 3;
  EXPECT_NE(RenderReport(data)->find("Usable, with care:</b> Connected pieces"), std::string::npos);
  data.hole_count = 2;
  EXPECT_NE(RenderReport(data)->find("Do not rely on this mosaic before you have looked into:</b> Parts that failed"), std::string::npos);
}

TEST(Report, FoldsWhatManyWindowsSayAlikeAndLeavesNothingOut) {
  ReportData data = GoodData();
  for (int window = 0; window < 5; ++window)
    data.notes.push_back({false, "bad_pixels", "window " + std::to_string(window), "some were found"});
  for (int frame = 0; frame < 3; ++frame) data.notes.push_back({false, "brightness_jump", "frame " + std::to_string(frame), "jumps"});
  data.notes.push_back({true, "pieces", "", "two of them"});
  const std::string page = *RenderReport(data);
  const auto at = [&page](const std::string& text) { return page.find(text); };
  EXPECT_NE(at("<summary><b>window 0</b>: some were found <small>(bad_pixels)</small> <i>and 4 more like this</i></summary>"),
            std::string::npos);
  for (const ReportNote& note : data.notes) {
    const std::string line = (note.subject.empty() ? "" : "<b>" + note.subject + "</b>: ") + note.message;
    EXPECT_NE(at(line), std::string::npos) << line;
  }
  EXPECT_EQ(at("<details"), page.rfind("<details")) << "three notes are few enough to stand by themselves";
  EXPECT_LT(at("two of them"), at("window 0")) << "warnings come first";
  EXPECT_LT(at("window 4"), at("</details>"));
  EXPECT_LT(at("</details>"), at("frame 0"));
}

TEST(Report, MapsFootprintsTrackAndScaleInMosaicPixels) {
  ReportData data = GoodData();
  data.preview.png = "png";
  data.map.footprints = {{{0.0, 0.0}, {99.5, 0.0}, {99.5, 50.0}}};
  data.map.footprint_count = 7;
  data.map.tracks = {{{10.0, 20.0}, {30.0, 40.0}}};
  const std::string svg = MapSvg(data);
  for (const char* expected : {"viewBox=\"0 0 800 400\"", "points=\"0.5,0.5 100.0,0.5 100.0,50.5\"", "points=\"10.5,20.5 30.5,40.5\"",
                               "1 of 7 footprints", ">50 m<"}) {
    EXPECT_NE(svg.find(expected), std::string::npos) << expected << " in " << svg;
  }
}

TEST(Report, RoundsLengthsDownToOneTwoOrFive) {
  EXPECT_DOUBLE_EQ(RoundLength(99.0), 50.0);
  EXPECT_DOUBLE_EQ(RoundLength(100.0), 100.0);
  EXPECT_DOUBLE_EQ(RoundLength(0.24), 0.2);
}

}  // namespace
}  // namespace trem
