#include "coordinator/cli/published_text.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "coordinator/cli/job_report.h"
#include "coordinator/cli/outputs.h"
#include "coordinator/cli/terminal.h"

namespace trem {
namespace {

constexpr const char* kReportName = "mosaic_report.html";
constexpr const char* kStacName = "mosaic.stac.json";
// kReportTimesMark of mosaic/publish/report.h, which this folder may not include.
constexpr const char* kTimesMark = "<!-- times -->";

std::string TimesTable(const v1::JobStatus& job) {
  std::string html = "<h2>Times</h2>\n<table>\n<tr><th>Stage</th><th>Tasks</th><th>Work</th><th>A task</th></tr>\n";
  double sum_s = 0.0;
  for (const v1::StageStatus& stage : job.stages()) {
    const double seconds = static_cast<double>(stage.elapsed_ms()) / 1000.0;
    sum_s += seconds;
    html += fmt::format("<tr><td>{}</td><td>{}</td><td>{:.1f} s</td><td>{:.2f} s</td></tr>\n", TaskKindName(stage.kind()), stage.total(),
                        seconds, stage.done() > 0 ? seconds / stage.done() : 0.0);
  }
  html += fmt::format("<tr><th>all</th><td></td><td>{:.1f} s</td><td></td></tr>\n</table>\n", sum_s);
  html += "<p class=\"caption\">Of the workers, added up: with several at work the job itself was shorter.";
  if (job.peak_memory_bytes() > 0) {
    html += fmt::format(" A worker needed at most {}.", FormatBytes(static_cast<double>(job.peak_memory_bytes())));
  }
  if (job.retries() > 0) html += fmt::format(" {} tasks had to be handed out again.", job.retries());
  return html + "</p>\n";
}

Result<std::string> WithPublishedNames(const std::string& text, const std::filesystem::path& output) {
  nlohmann::ordered_json item = nlohmann::ordered_json::parse(text, nullptr, false);
  if (!item.is_object() || !item.contains("assets") || !item["assets"].is_object()) {
    return Corrupt(std::string("result ") + kStacName + " is not the JSON of a STAC item");
  }
  constexpr std::string_view kHere = "./";
  for (auto& [key, asset] : item["assets"].items()) {
    if (!asset.is_object() || !asset.contains("href") || !asset["href"].is_string()) continue;
    std::string href = asset["href"].get<std::string>();
    if (href.compare(0, kHere.size(), kHere) == 0) href.erase(0, kHere.size());
    TREM_ASSIGN_OR_RETURN(const std::filesystem::path path, OutputPath(output, href));
    asset["href"] = std::string(kHere) + path.filename().string();
  }
  return DumpJson(item) + "\n";
}

}  // namespace

bool IsFinishedWhenPublished(const std::string& name) { return name == kReportName || name == kStacName; }

Result<std::string> FinishedText(const std::string& name, const std::string& text, const std::filesystem::path& output,
                                 const v1::JobStatus& job) {
  if (name == kStacName) return WithPublishedNames(text, output);
  if (name != kReportName) return text;
  std::string html = text;
  const std::size_t mark = html.find(kTimesMark);
  if (mark != std::string::npos) html.replace(mark, std::string(kTimesMark).size(), TimesTable(job));
  return html;
}

}  // namespace trem
