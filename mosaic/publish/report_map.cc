#include "mosaic/publish/report_map.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace trem {
namespace {

std::string Points(const std::vector<Eigen::Vector2d>& points) {
  std::string text;
  // SVG counts from the pixel's corner.
  for (const Eigen::Vector2d& point : points) text += fmt::format("{:.1f},{:.1f} ", point.x() + 0.5, point.y() + 0.5);
  if (!text.empty()) text.pop_back();
  return text;
}

std::string ScaleBar(const ReportData& data, double unit) {
  const double length = RoundLength(0.25 * data.width * data.gsd);
  const double pixels = length / data.gsd;
  const double x = 0.03 * data.width, y = data.height - 14.0 * unit;
  const std::string label = data.georeferenced
                                ? (length >= 1000.0 ? fmt::format("{:g} km", length / 1000.0) : fmt::format("{:g} m", length))
                                : fmt::format("{:g} sensor px", length);
  std::string svg =
      fmt::format("<g><rect x=\"{:.1f}\" y=\"{:.1f}\" width=\"{:.1f}\" height=\"{:.1f}\" fill=\"#000\" fill-opacity=\".55\"/>",
                  x - 5.0 * unit, y - 15.0 * unit, std::max(pixels, 55.0 * unit) + 10.0 * unit, 22.0 * unit);
  svg += fmt::format("<rect x=\"{:.1f}\" y=\"{:.1f}\" width=\"{:.1f}\" height=\"{:.1f}\" fill=\"#fff\"/>", x, y, pixels, 3.0 * unit);
  svg += fmt::format("<text x=\"{:.1f}\" y=\"{:.1f}\" font-size=\"{:.1f}\" fill=\"#fff\">{}</text></g>\n", x, y - 3.0 * unit, 11.0 * unit,
                     HtmlEscaped(label));
  return svg;
}

}  // namespace

double RoundLength(double length) {
  const double power = std::pow(10.0, std::floor(std::log10(length)));
  for (const double factor : {5.0, 2.0}) {
    if (factor * power <= length) return factor * power;
  }
  return power;
}

std::string MapSvg(const ReportData& data) {
  if (data.preview.png.empty()) return "";
  // Of the page's about 1000 px of width.
  const double unit = std::max(data.width, data.height) / 1000.0;
  std::string html =
      "<div class=\"map\"><input type=\"checkbox\" id=\"footprints\" checked><label for=\"footprints\">footprints of scenes</label> "
      "<input type=\"checkbox\" id=\"track\" checked><label for=\"track\">track of the image centre</label>\n";
  html += fmt::format("<svg viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"Map of the mosaic\">\n", data.width, data.height);
  html += fmt::format("<image width=\"{}\" height=\"{}\" href=\"data:image/png;base64,{}\"/>\n", data.width, data.height,
                      Base64(data.preview.png));
  html += fmt::format("<g class=\"footprints\" fill=\"none\" stroke=\"#ffc800\" stroke-opacity=\".55\" stroke-width=\"{:.2f}\">\n", unit);
  for (const std::vector<Eigen::Vector2d>& ring : data.map.footprints) html += "<polygon points=\"" + Points(ring) + "\"/>\n";
  html += fmt::format("</g>\n<g class=\"track\" fill=\"none\" stroke=\"#ff3b30\" stroke-width=\"{:.2f}\">\n", 2.0 * unit);
  for (const std::vector<Eigen::Vector2d>& track : data.map.tracks) {
    if (track.empty()) continue;
    html += "<polyline points=\"" + Points(track) + "\"/>\n";
    html += fmt::format("<circle cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"{:.2f}\" fill=\"#ff3b30\"/>\n", track[0].x() + 0.5, track[0].y() + 0.5,
                        5.0 * unit);
  }
  html += "</g>\n" + ScaleBar(data, unit) + "</svg></div>\n";
  html += "<p class=\"caption\">The mosaic, reduced; grey where nothing was seen. ";
  html += data.georeferenced ? "Up is grid north. " : "No place on Earth. ";
  html += fmt::format("Black is {:.4g}, white {:.4g} grey levels of the source. ", data.preview.range.low, data.preview.range.high);
  if (data.map.footprint_count > data.map.footprints.size()) {
    html += fmt::format("{} of {} footprints are drawn. ", data.map.footprints.size(), data.map.footprint_count);
  }
  html += "A dot marks where a track begins.</p>\n";
  if (data.map.corners.empty()) return html;
  html += "<table>\n";
  for (const auto& [corner, place] : data.map.corners) {
    html += "<tr><th>" + HtmlEscaped(corner) + "</th><td>" + HtmlEscaped(place) + "</td></tr>\n";
  }
  return html + "</table>\n";
}

}  // namespace trem
