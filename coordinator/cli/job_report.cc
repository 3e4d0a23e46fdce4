#include "coordinator/cli/job_report.h"

#include <algorithm>
#include <cctype>
#include <string_view>

#include "mosaic/base/status.h"
#include "proto/codec/convert.h"

namespace trem {
namespace {

using nlohmann::ordered_json;

std::string LowerCase(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return text;
}

std::string ErrorCodeName(std::uint32_t code) {
  if (code > static_cast<std::uint32_t>(StatusCode::kFailed)) return ToString(StatusCode::kFailed);
  return ToString(static_cast<StatusCode>(code));
}

}  // namespace

std::string TaskKindName(v1::TaskKind kind) { return v1::TaskKind_IsValid(kind) ? LowerCase(v1::TaskKind_Name(kind)) : "unknown"; }

std::string JobStateName(v1::JobState state) {
  constexpr std::string_view kPrefix = "JOB_";
  return v1::JobState_IsValid(state) ? LowerCase(v1::JobState_Name(state).substr(kPrefix.size())) : "unknown";
}

ordered_json JobJson(const v1::JobStatus& job) {
  ordered_json json;
  json["job_id"] = job.job_id();
  json["name"] = job.name();
  json["state"] = JobStateName(job.state());
  json["fraction"] = job.fraction();
  json["eta_s"] = job.eta_s() < 0 ? ordered_json() : ordered_json(job.eta_s());
  json["eta_low_s"] = job.eta_low_s() < 0 ? ordered_json() : ordered_json(job.eta_low_s());
  json["eta_high_s"] = job.eta_high_s() < 0 ? ordered_json() : ordered_json(job.eta_high_s());
  json["stages"] = ordered_json::array();
  for (const v1::StageStatus& stage : job.stages()) {
    json["stages"].push_back({{"kind", TaskKindName(stage.kind())},
                              {"total", stage.total()},
                              {"done", stage.done()},
                              {"running", stage.running()},
                              {"elapsed_ms", stage.elapsed_ms()}});
  }
  json["outputs"] = ordered_json::array();
  for (const v1::ArtefactRef& output : job.outputs()) {
    json["outputs"].push_back({{"name", output.name()}, {"bytes", output.bytes()}, {"sha256", output.sha256()}});
  }
  json["notes"] = ordered_json::array();
  for (const v1::Note& note : job.notes()) {
    json["notes"].push_back({{"severity", note.severity() == v1::WARNING ? "warning" : "info"},
                             {"code", note.code()},
                             {"subject", note.subject()},
                             {"message", note.message()}});
  }
  json["holes"] = ordered_json::array();
  for (const v1::Note& hole : job.holes()) json["holes"].push_back({{"task", hole.subject()}, {"message", hole.message()}});
  json["peak_memory_bytes"] = job.peak_memory_bytes();
  json["worker_count"] = job.worker_count();
  json["retries"] = job.retries();
  if (job.state() == v1::JOB_FAILED) json["error"] = {{"code", ErrorCodeName(job.error_code())}, {"message", job.error()}};
  return json;
}

std::vector<std::string> WarningLines(const v1::JobStatus& job, std::size_t count_max) {
  std::vector<std::string> lines;
  std::size_t count = 0;
  const auto add = [&](const v1::Note& note) {
    if (++count <= count_max) lines.push_back(NoteText(note));
  };
  for (const v1::Note& hole : job.holes()) add(hole);
  for (const v1::Note& note : job.notes()) {
    if (note.severity() == v1::WARNING) add(note);
  }
  if (count > count_max) lines.push_back("... and " + std::to_string(count - count_max) + " more; --json lists all");
  return lines;
}

std::string DumpJson(const ordered_json& json) { return json.dump(2, ' ', false, ordered_json::error_handler_t::replace); }

}  // namespace trem
