#pragma once

#include <string>
#include <utility>
#include <vector>

#include "mosaic/publish/line_chart.h"
#include "mosaic/publish/report.h"

namespace trem {

// A picture of a scene report. With a legend when it stands for numbers: colours from range.low to range.high.
struct ScenePicture {
  ReportPicture picture;
  std::string title;
  std::string unit;     // Of the legend; empty: no legend.
  bool wide = false;    // Across the page.
};

// Everything that the report of `trem enhance` tells. Texts are plain: the report escapes them.
struct SceneReport {
  std::string title;
  std::string summary;                                      // One sentence.
  std::vector<std::pair<std::string, std::string>> numbers;  // Name, value.
  std::vector<std::string> notes;
  std::vector<ScenePicture> pictures;
  std::vector<LineChart> charts;  // Those without a finite value are left out.
  std::vector<std::pair<std::string, std::string>> files;  // Name, what is in it.
};

// A self-contained page like RenderReport's: no scripts, no references; pictures and charts inline. Same report, same bytes.
Result<std::string> RenderSceneReport(const SceneReport& report);

}  // namespace trem
