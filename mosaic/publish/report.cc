#include "mosaic/publish/report.h"

#include <fmt/format.h>

#include <cmath>

namespace trem {
namespace {

constexpr const char* kHeadBeforeTitle = R"(<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>)";
constexpr const char* kHeadAfterTitle = R"(</title>
<style>
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 1000px; margin: 2em auto; padding: 0 1em; }
h1 { font-size: 1.6em; margin-bottom: 0; }
h2 { font-size: 1.2em; margin-top: 1.8em; border-bottom: 1px solid #ddd; }
table { border-collapse: collapse; }
td, th { padding: .15em 1em .15em 0; text-align: left; vertical-align: top; }
th { font-weight: 600; }
img { max-width: 100%; background: #8a8a8a; display: block; }
figure { margin: 0; } figcaption { color: #555; font-size: .9em; }
.pair { display: grid; grid-template-columns: 1fr 1fr; gap: 1em; }
.local, .warning { background: #fff3d6; padding: .3em .6em; border-left: 4px solid #e0a000; margin: .3em 0; }
.info { color: #555; padding: .3em .6em; }
.scale { display: inline-block; width: 8em; height: .8em; vertical-align: middle;
  background: linear-gradient(90deg, #440154, #3b528b, #21918c, #5ec962, #fde725); }
</style>
</head>
<body>
)";

std::string Number(double value, int digits) { return std::isfinite(value) ? fmt::format("{:.{}f}", value, digits) : "not known"; }

std::string Row(const std::string& name, const std::string& value) {
  return "<tr><th>" + HtmlEscaped(name) + "</th><td>" + HtmlEscaped(value) + "</td></tr>\n";
}

std::string Img(const ReportPicture& picture, const std::string& alt) {
  return "<img alt=\"" + HtmlEscaped(alt) + "\" src=\"data:image/png;base64," + Base64(picture.png) + "\">\n";
}

std::string Legend(const ValueRange& range, const std::string& what, int digits) {
  return "<figcaption>" + HtmlEscaped(what) + ": " + Number(range.low, digits) + " <span class=\"scale\"></span> " +
         Number(range.high, digits) + "</figcaption>\n";
}

std::string Numbers(const ReportData& data) {
  const std::string unit = data.georeferenced ? " m" : " sensor px";
  std::string html = "<h2>Numbers</h2>\n<table>\n";
  html += Row("Frames", fmt::format("{} of {} registered; {} lost; {} not usable; {} in no window", data.registered_count, data.frame_count,
                                    data.lost_count, data.skipped_count, data.not_used_count));
  html += Row("Mosaic", fmt::format("{} x {} pixels, {:.1f} % covered", data.width, data.height, 100.0 * data.coverage));
  html += Row("Ground sample distance", fmt::format("{:.4g}", data.gsd) + unit);
  html += Row("Coordinates", data.georeferenced ? data.crs_name : "local coordinates: no telemetry (" + data.crs_name + ")");
  html += Row("Windows, scenes, pieces", fmt::format("{}, {}, {}", data.window_count, data.scene_count, data.piece_count));
  html += Row("Residual of the ties (rms)", Number(data.tie_rms_px, 3) + " sensor px");
  html += Row("Scenes over a covered pixel (median)", Number(data.median_scenes, 1));
  html += Row("Spread between scenes (median NMAD)", Number(data.median_nmad, 2) + " grey levels");
  html += Row("Standard error of position (median)", Number(data.median_position_sigma, 3) + unit);
  html += Row("Gauge", data.gauge);
  html += Row("Source", data.source);
  html += Row("Software", data.software);
  return html + "</table>\n";
}

std::string Pictures(const ReportData& data) {
  std::string html;
  if (!data.preview.png.empty()) {
    html += "<figure>" + Img(data.preview, "Preview of the mosaic") +
            "<figcaption>The mosaic, reduced; grey where nothing was seen. Black is " + Number(data.preview.range.low, 1) + ", white " +
            Number(data.preview.range.high, 1) + " grey levels of the source.</figcaption></figure>\n";
  }
  html += "<div class=\"pair\">\n";
  if (!data.count.png.empty()) {
    html += "<figure>" + Img(data.count, "Scenes a pixel") + Legend(data.count.range, "Scenes over each pixel", 0) + "</figure>\n";
  }
  if (!data.nmad.png.empty()) {
    html += "<figure>" + Img(data.nmad, "Spread between scenes") + Legend(data.nmad.range, "Spread between scenes (NMAD), grey levels", 2) +
            "</figure>\n";
  }
  return html + "</div>\n";
}

std::string Notes(const ReportData& data) {
  if (data.notes.empty()) return "";
  std::string html = "<h2>Warnings and notes</h2>\n";
  for (const bool warning : {true, false}) {
    for (const ReportNote& note : data.notes) {
      if (note.warning != warning) continue;
      html += std::string("<div class=\"") + (warning ? "warning" : "info") + "\">";
      if (!note.subject.empty()) html += "<b>" + HtmlEscaped(note.subject) + "</b>: ";
      html += HtmlEscaped(note.message) + " <small>(" + HtmlEscaped(note.code) + ")</small></div>\n";
    }
  }
  return html;
}

std::string MissingFrames(const ReportData& data) {
  if (data.missing_frame_count == 0) return "";
  std::string html = "<h2>Frames that are not in the mosaic</h2>\n<table>\n<tr><th>Frame</th><th>Status</th><th>Reason</th></tr>\n";
  for (const ReportFrame& frame : data.missing_frames) {
    html += "<tr><td>" + HtmlEscaped(frame.name) + "</td><td>" + HtmlEscaped(frame.status) + "</td><td>" + HtmlEscaped(frame.reason) +
            "</td></tr>\n";
  }
  html += "</table>\n";
  if (data.missing_frames.size() < data.missing_frame_count) {
    html += fmt::format("<p>... and {} more: see mosaic_chain.csv.</p>\n", data.missing_frame_count - data.missing_frames.size());
  }
  return html;
}

}  // namespace

std::string HtmlEscaped(const std::string& text) {
  std::string escaped;
  for (const char c : text) {
    switch (c) {
      case '&':
        escaped += "&amp;";
        break;
      case '<':
        escaped += "&lt;";
        break;
      case '>':
        escaped += "&gt;";
        break;
      case '"':
        escaped += "&quot;";
        break;
      case '\'':
        escaped += "&#39;";
        break;
      default:
        escaped += static_cast<unsigned char>(c) < 0x20 || c == 0x7f ? ' ' : c;
    }
  }
  return escaped;
}

std::string HtmlPageStart(const std::string& title) { return kHeadBeforeTitle + HtmlEscaped(title) + kHeadAfterTitle; }

std::string RenderReport(const ReportData& data) {
  std::string html = HtmlPageStart("Mosaic report");
  html += "<h1>" + HtmlEscaped(data.sortie) + "</h1>\n";
  html += fmt::format("<p>{} of {} frames made a mosaic of {} x {} pixels at {:.4g} {} a pixel.</p>\n", data.registered_count,
                      data.frame_count, data.width, data.height, data.gsd, data.georeferenced ? "m" : "sensor px");
  if (!data.georeferenced) {
    html +=
        "<p class=\"local\"><b>Local coordinates: no telemetry.</b> This mosaic has no place on Earth. Its unit is one sensor pixel; "
        "scale, north and position are arbitrary" +
        std::string(data.piece_count > 1 ? ", and so is how its separate pieces lie to each other" : "") + ".</p>\n";
  }
  html += Pictures(data);
  html += Numbers(data);
  html += Notes(data);
  html += MissingFrames(data);
  html += "<h2>Files</h2>\n<table>\n" + Row("mosaic.tif", "median intensity, Cloud Optimized GeoTIFF; NaN where nothing was seen") +
          Row("mosaic_quality.tif", "bands: scenes that took part, NMAD [grey levels], standard error of position [CRS units]") +
          Row("mosaic_source.tif", "window id of the scene that dominates each pixel; -1 where nothing was seen") +
          Row("mosaic_chain.csv", "every frame in every window: transform, gain, offset, residual, or why it is missing") +
          Row("mosaic_windows.geojson", "footprints of the scenes") + Row("mosaic_preview.png", "the picture above") + "</table>\n";
  return html + "</body>\n</html>\n";
}

}  // namespace trem
