#include "mosaic/publish/scene_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace trem {
namespace {

std::string Table(const std::vector<std::pair<std::string, std::string>>& rows) {
  std::string html = "<table>\n";
  for (const auto& [name, value] : rows) html += "<tr><th>" + HtmlEscaped(name) + "</th><td>" + HtmlEscaped(value) + "</td></tr>\n";
  return html + "</table>\n";
}

std::string Img(const std::string& title, const std::string& png, const char* style) {
  return fmt::format("<img alt=\"{}\" style=\"{}\" src=\"data:image/png;base64,{}\">\n", HtmlEscaped(title), style, Base64(png));
}

std::string Figure(const ScenePicture& shown) {
  std::string html = "<figure>" + Img(shown.title, shown.picture.png, "width:100%;image-rendering:pixelated") + "<figcaption>" + HtmlEscaped(shown.title);
  if (!shown.unit.empty()) {
    html += fmt::format(": {:.3g} <span class=\"scale\"></span> {:.3g} ", shown.picture.range.low, shown.picture.range.high) +
            HtmlEscaped(shown.unit);
  }
  return html + "</figcaption></figure>\n";
}

}  // namespace

Result<std::string> RenderSceneReport(const SceneReport& report) {
  std::string html = HtmlPageStart(report.title);
  html += "<h1>" + HtmlEscaped(report.title) + "</h1>\n<p>" + HtmlEscaped(report.summary) + "</p>\n";
  for (const std::string& note : report.notes) html += "<div class=\"warning\">" + HtmlEscaped(note) + "</div>\n";
  std::string pairs;
  for (const ScenePicture& shown : report.pictures) {
    if (!shown.picture.png.empty()) (shown.wide ? html : pairs) += Figure(shown);
  }
  if (!pairs.empty()) html += "<div class=\"pair\">\n" + pairs + "</div>\n";
  html += "<h2>Numbers</h2>\n" + Table(report.numbers);
  html += "<h2>Frame by frame</h2>\n<div class=\"pair\">\n";
  for (const LineChart& chart : report.charts) {
    if (!HasValue(chart)) continue;
    TREM_ASSIGN_OR_RETURN(const std::string png, LineChartPng(chart));
    html += Img(chart.title, png, "width:100%");
  }
  html += "</div>\n<h2>Files</h2>\n" + Table(report.files);
  return html + "</body>\n</html>\n";
}

}  // namespace trem
