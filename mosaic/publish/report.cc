#include "mosaic/publish/report.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "mosaic/base/parallel.h"
#include "mosaic/publish/report_map.h"

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
.triple { display: grid; grid-template-columns: 1fr 1fr 1fr; gap: .8em; }
.crop { width: 100%; image-rendering: pixelated; }
.caption { color: #555; font-size: .9em; }
.verdict { padding: .5em .8em; border-left: 5px solid; }
.good { color: #14532d; background: #dcf5e3; border-color: #2e9e55; } .look { color: #6b4a00; background: #fff3d6; border-color: #e0a000; }
.poor { color: #7a1010; background: #fde0de; border-color: #d6332b; }
.checks span { display: inline-block; min-width: 3em; text-align: center; padding: 0 .4em; border-radius: .3em; }
.checks td, .checks th { white-space: nowrap; } .checks td.caption { white-space: normal; }
.map svg { width: 100%; max-height: 85vh; background: #8a8a8a; display: block; font-family: system-ui, sans-serif; }
.map label { margin-right: 1em; font-size: .9em; color: #555; }
#footprints:not(:checked) ~ svg .footprints, #track:not(:checked) ~ svg .track { display: none; }
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

const char* VerdictName(ReportCheck::Verdict verdict) {
  switch (verdict) {
    case ReportCheck::Verdict::kGood:
      return "good";
    case ReportCheck::Verdict::kLook:
      return "look";
    default:
      return "poor";
  }
}

std::string Verdict(const ReportData& data) {
  const std::vector<ReportCheck> checks = JudgeMosaic(data);
  std::string look, poor, rows;
  for (const ReportCheck& check : checks) {
    const char* const name = VerdictName(check.verdict);
    if (check.verdict == ReportCheck::Verdict::kLook) look += (look.empty() ? "" : ", ") + check.name;
    if (check.verdict == ReportCheck::Verdict::kBad) poor += (poor.empty() ? "" : ", ") + check.name;
    rows += fmt::format("<tr><td><span class=\"{}\">{}</span></td><th>{}</th><td>{}</td><td class=\"caption\">{}</td></tr>\n", name, name,
                        HtmlEscaped(check.name), HtmlEscaped(check.value), HtmlEscaped(check.reason));
  }
  std::string html = "<p class=\"verdict ";
  if (!poor.empty()) {
    html +=
        "poor\"><b>Do not rely on this mosaic before you have looked into:</b> " + HtmlEscaped(poor + (look.empty() ? "" : ", " + look));
  } else if (!look.empty()) {
    html += "look\"><b>Usable, with care:</b> " + HtmlEscaped(look);
  } else {
    html += "good\"><b>Nothing that was measured speaks against this mosaic.</b>";
  }
  return html + "</p>\n<table class=\"checks\">\n" + rows + "</table>\n";
}

std::string Crops(const ReportData& data) {
  if (data.crops.empty()) return "";
  std::string html = "<h2>Is it sharper? Where there is most detail</h2>\n<div class=\"triple\">\n";
  const auto figure = [](const std::string& png, const std::string& title, const std::string& text) {
    if (png.empty()) return "<figure><figcaption><b>" + HtmlEscaped(title) + "</b>: not available here</figcaption></figure>\n";
    return "<figure><img class=\"crop\" alt=\"" + HtmlEscaped(title) + "\" src=\"data:image/png;base64," + Base64(png) +
           "\"><figcaption><b>" + HtmlEscaped(title) + "</b>" + HtmlEscaped(text) + "</figcaption></figure>\n";
  };
  for (const ReportCrop& crop : data.crops) {
    html += figure(crop.frame_png, "One frame, bicubic", " " + crop.frame);
    html += figure(crop.baseline_png, "Baseline", " frames placed by image motion alone");
    html += figure(crop.mosaic_png, "This mosaic", " " + crop.place);
  }
  return html +
         "</div>\n<p class=\"caption\">The same ground and the same stretch of grey in a row. The baseline is what a mosaic at the "
         "sensor's "
         "resolution shows: the median of frames that follow each other by whole-image motion, so it may lie off by its drift.</p>\n";
}

std::string Numbers(const ReportData& data) {
  const std::string unit = data.georeferenced ? " m" : " sensor px";
  std::string html = "<h2>Numbers</h2>\n<table>\n";
  html += Row("Frames", fmt::format("{} of {} registered; {} lost; {} not usable; {} in no window", data.registered_count, data.frame_count,
                                    data.lost_count, data.skipped_count, data.not_used_count));
  html += Row("Mosaic", fmt::format("{} x {} pixels, {:.1f} % of the rectangle covered", data.width, data.height, 100.0 * data.coverage));
  html += Row("Ground sample distance", fmt::format("{:.4g}", data.gsd) + unit);
  html += Row("Coordinates", data.georeferenced ? data.crs_name : "local coordinates: no telemetry (" + data.crs_name + ")");
  html += Row("Windows, scenes, pieces", fmt::format("{}, {}, {}", data.window_count, data.scene_count, data.piece_count));
  html += Row("A pixel is", data.estimator);
  html += Row("Residual of the ties (rms)", Number(data.tie_rms_px, 3) + " sensor px");
  html += Row("Scenes over a covered pixel (median)", Number(data.median_scenes, 1));
  html += Row("Spread between scenes (median NMAD)", Number(data.median_nmad, 2) + " grey levels");
  html += Row("Standard error of position (median)", Number(data.median_position_sigma, 3) + unit);
  html += Row("Gauge", data.gauge);
  html += Row("Source", data.source);
  html += Row("Software", data.software);
  return html + "</table>\n";
}

std::string Maps(const ReportData& data) {
  const std::string unit = data.georeferenced ? "m" : "sensor px";
  std::string html = "<h2>Where to trust it</h2>\n<div class=\"triple\">\n";
  const auto figure = [](const ReportPicture& picture, const std::string& alt, const std::string& legend, int digits) {
    return picture.png.empty() ? std::string() : "<figure>" + Img(picture, alt) + Legend(picture.range, legend, digits) + "</figure>\n";
  };
  html += figure(data.count, "Scenes a pixel", "Coverage: scenes over each pixel", 0);
  html += figure(data.nmad, "Spread between scenes", "Spread between scenes (NMAD), grey levels", 2);
  html += figure(data.sigma, "Standard error of position", "Standard error of position, " + unit, 3);
  return html + "</div>\n";
}

Result<std::string> Charts(const ReportData& data, int threads) {
  std::vector<Result<std::string>> pngs(data.charts.size(), std::string());
  ForEachIndex(threads, static_cast<int>(pngs.size()), [&](int index, int) {
    const auto i = static_cast<std::size_t>(index);
    if (HasValue(data.charts[i])) pngs[i] = LineChartPng(data.charts[i]);
  });
  std::string html;
  for (std::size_t i = 0; i < pngs.size(); ++i) {
    TREM_RETURN_IF_ERROR(pngs[i].status());
    if (pngs[i]->empty()) continue;
    html +=
        "<figure><img alt=\"" + HtmlEscaped(data.charts[i].title) + "\" src=\"data:image/png;base64," + Base64(*pngs[i]) + "\"></figure>\n";
  }
  return html.empty() ? html : "<h2>Frame by frame</h2>\n<div class=\"pair\">\n" + html + "</div>\n";
}

// "subject: message (code)".
std::string NoteLine(const ReportNote& note) {
  return (note.subject.empty() ? "" : "<b>" + HtmlEscaped(note.subject) + "</b>: ") + HtmlEscaped(note.message) + " <small>(" +
         HtmlEscaped(note.code) + ")</small>";
}

// Warnings first. What many windows or frames say alike takes one line, which opens.
std::string Notes(const ReportData& data) {
  constexpr std::size_t kUnfoldedMax = 3;
  if (data.notes.empty()) return "";
  std::map<std::pair<bool, std::string>, std::vector<const ReportNote*>> alike;
  std::vector<std::pair<bool, std::string>> order;
  for (const ReportNote& note : data.notes) {
    std::vector<const ReportNote*>& notes = alike[{note.warning, note.code}];
    if (notes.empty()) order.emplace_back(note.warning, note.code);
    notes.push_back(&note);
  }
  std::stable_partition(order.begin(), order.end(), [](const auto& group) { return group.first; });
  std::string html = "<h2>Warnings and notes</h2>\n";
  for (const auto& group : order) {
    const std::vector<const ReportNote*>& notes = alike[group];
    const std::string style = group.first ? "warning" : "info";
    const bool folded = notes.size() > kUnfoldedMax;
    if (folded) {
      html += fmt::format("<details class=\"{}\"><summary>{} <i>and {} more like this</i></summary>\n", style, NoteLine(*notes.front()),
                          notes.size() - 1);
    }
    for (std::size_t i = folded ? 1 : 0; i < notes.size(); ++i) {
      html += fmt::format("<div class=\"{}\">{}</div>\n", style, NoteLine(*notes[i]));
    }
    if (folded) html += "</details>\n";
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

Result<std::string> RenderReport(const ReportData& data, int threads) {
  std::string html = HtmlPageStart("Mosaic report: " + data.sortie);
  html += "<h1>" + HtmlEscaped(data.sortie) + "</h1>\n";
  html += fmt::format("<p>{} of {} frames made a mosaic of {} x {} pixels at {:.4g} {} a pixel.</p>\n", data.registered_count,
                      data.frame_count, data.width, data.height, data.gsd, data.georeferenced ? "m" : "sensor px");
  if (!data.georeferenced) {
    html +=
        "<p class=\"local\"><b>Local coordinates: no telemetry.</b> This mosaic has no place on Earth. Its unit is one sensor pixel; "
        "scale, north and position are arbitrary" +
        std::string(data.piece_count > 1 ? ", and so is how its separate pieces lie to each other" : "") + ".</p>\n";
  }
  html += Verdict(data);
  html += MapSvg(data);
  html += Crops(data);
  html += Maps(data);
  TREM_ASSIGN_OR_RETURN(const std::string charts, Charts(data, threads));
  html += charts;
  html += Notes(data);
  html += Numbers(data);
  html += std::string(kReportTimesMark) + "\n";
  html += MissingFrames(data);
  html += "<h2>Files</h2>\n<table>\n" + Row("mosaic.tif", "intensity, Cloud Optimized GeoTIFF; nodata where nothing was seen") +
          Row("mosaic_quality.tif", "bands: scenes that took part, NMAD [grey levels], standard error of position [CRS units]") +
          Row("mosaic_source.tif", "window id of the scene that dominates each pixel; -1 where nothing was seen");
  if (data.baseline_written) html += Row("mosaic_baseline.tif", "the baseline mosaic, at the sensor's resolution");
  html += Row("mosaic_chain.csv", "every frame in every window: transform, gain, offset, residual, or why it is missing") +
          Row("mosaic_windows.geojson", "footprints of the scenes") + Row("mosaic.stac.json", "STAC item: place, bands, checksums") +
          Row("mosaic_preview.png", "the picture above") + "</table>\n";
  return html + "</body>\n</html>\n";
}

}  // namespace trem
