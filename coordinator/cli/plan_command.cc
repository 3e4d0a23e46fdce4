#include "coordinator/cli/plan_command.h"

#include <fmt/format.h>
#include <signal.h>
#include <sys/wait.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <set>
#include <string_view>
#include <tuple>

#include "coordinator/cli/child_process.h"
#include "coordinator/cli/interrupt.h"
#include "coordinator/cli/job_report.h"
#include "coordinator/cli/terminal.h"
#include "coordinator/planning/memory_estimate.h"
#include "coordinator/planning/window_plan.h"
#include "mosaic/base/file.h"
#include "proto/codec/convert.h"
#include "proto/codec/sortie_spec.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

constexpr std::uint64_t kManifestBytesMax = std::uint64_t{512} << 20;
constexpr double kBytesPerCell = 8.0;  // Intensity and information, float32 each; before compression.

// Removed with its contents on destruction.
struct ScratchFolder {
  fs::path path;
  ~ScratchFolder() {
    std::error_code ignored;
    if (!path.empty()) fs::remove_all(path, ignored);
  }
};

// Displacement of the image centre between a frame and the usable one before it, px; negative: unknown.
double CentreMotion(const v1::SortieManifest& manifest, const v1::ManifestFrame& frame) {
  if (frame.previous_from_current_size() != 6 || frame.motion_correlation() <= 0.0) return -1.0;
  const auto& m = frame.previous_from_current();
  const double x = (manifest.width_px() - 1.0) / 2.0;
  const double y = (manifest.height_px() - 1.0) / 2.0;
  return std::hypot(m[0] * x + m[1] * y + m[2] - x, m[3] * x + m[4] * y + m[5] - y);
}

// Waits for the child; an interrupt kills it (its own process group keeps Ctrl-C away from it).
Status AwaitChild(pid_t pid, int* wait_status) {
  while (::waitpid(pid, wait_status, 0) < 0) {
    if (errno != EINTR) return FromErrno("cannot wait for trem-worker", errno);
    if (InterruptSignal() != 0) ::kill(pid, SIGKILL);
  }
  return InterruptSignal() == 0 ? Status() : Cancelled("interrupted");
}

// The worker opens the pixels; this process links no library that could.
Result<v1::SortieManifest> ReadManifest(const std::string& sortie, const std::vector<std::string>& overrides, int* exit_code) {
  std::string name = (fs::temp_directory_path() / "trem-plan-XXXXXX").string();
  if (::mkdtemp(name.data()) == nullptr) return FromErrno("cannot create a folder " + name, errno);
  const ScratchFolder scratch{name};
  const fs::path manifest_path = scratch.path / "manifest.pb";
  TREM_ASSIGN_OR_RETURN(const fs::path programs, ProgramFolder());
  std::vector<std::string> argv = {(programs / "trem-worker").string(), "inspect", "--manifest", manifest_path.string()};
  for (const std::string& assignment : overrides) argv.insert(argv.end(), {"--set", assignment});
  argv.insert(argv.end(), {"--", sortie});
  TREM_ASSIGN_OR_RETURN(const pid_t pid, StartChild(argv, scratch.path / "log"));
  int wait_status = 0;
  TREM_RETURN_IF_ERROR(AwaitChild(pid, &wait_status));
  if (!WIFEXITED(wait_status) || WEXITSTATUS(wait_status) != 0) {
    *exit_code = WIFEXITED(wait_status) ? WEXITSTATUS(wait_status) : static_cast<int>(kExitFailed);
    std::string lines = LastLines(scratch.path / "log", 3);
    constexpr std::string_view kPrefix = "trem inspect: ";
    if (lines.compare(0, kPrefix.size(), kPrefix) == 0) lines.erase(0, kPrefix.size());
    return Failed(lines.empty() ? "the reading of " + sortie + " " + DescribeExit(wait_status) : lines);
  }
  TREM_ASSIGN_OR_RETURN(const std::string bytes, ReadFile(manifest_path, kManifestBytesMax));
  v1::SortieManifest manifest;
  if (!manifest.ParseFromString(bytes)) return Corrupt("trem-worker wrote a manifest of " + sortie + " that cannot be parsed");
  return manifest;
}

nlohmann::ordered_json PlanJson(const PlanReport& plan) {
  nlohmann::ordered_json json;
  json["frames"] = plan.frame_count;
  json["usable_frames"] = plan.usable_frame_count;
  json["spans"] = plan.span_count;
  json["width_px"] = plan.width_px;
  json["height_px"] = plan.height_px;
  json["rois"] = plan.roi_count;
  json["windows"] = plan.window_count;
  json["tasks"] = {{"ingest", 1}, {"enhance", plan.window_count}, {"align", 1}, {"composite", nullptr}, {"export", 1}};
  json["memory_bytes"] = {
      {"ingest", plan.ingest_memory_bytes}, {"enhance", plan.enhance_memory_bytes}, {"composite", plan.composite_memory_bytes}};
  json["disk_bytes"] = plan.disk_bytes;
  return json;
}

void PrintPlan(const PlanReport& plan) {
  fmt::print("frames     {} of {} x {} px, {} usable, in {} span{}\n", plan.frame_count, plan.width_px, plan.height_px,
             plan.usable_frame_count, plan.span_count, plan.span_count == 1 ? "" : "s");
  fmt::print("windows    {} (of {} regions of the sensor)\n", plan.window_count, plan.roi_count);
  fmt::print("tasks      ingest 1, enhance {}, align 1, composite one a tile of the mosaic, export 1\n", plan.window_count);
  fmt::print("memory     a worker needs at most {} to enhance, {} to composite\n",
             FormatBytes(static_cast<double>(plan.enhance_memory_bytes)), FormatBytes(static_cast<double>(plan.composite_memory_bytes)));
  fmt::print("disk       about {} of scenes while the job runs\n", FormatBytes(static_cast<double>(plan.disk_bytes)));
}

}  // namespace

v1::IngestSummary IngestSummaryFromManifest(const v1::SortieManifest& manifest) {
  v1::IngestSummary summary;
  summary.set_frame_count(static_cast<std::uint32_t>(manifest.frames_size()));
  summary.set_width_px(manifest.width_px());
  summary.set_height_px(manifest.height_px());
  *summary.mutable_valid_roi() = manifest.valid_roi();
  *summary.mutable_spans() = manifest.spans();
  std::vector<double> motions;
  std::uint32_t usable_count = 0;
  for (const v1::ManifestFrame& frame : manifest.frames()) {
    if (frame.state() != v1::FRAME_USABLE) continue;
    ++usable_count;
    if (const double motion = CentreMotion(manifest, frame); motion >= 0.0) motions.push_back(motion);
  }
  summary.set_usable_frame_count(usable_count);
  if (!motions.empty()) {
    const auto middle = motions.begin() + static_cast<std::ptrdiff_t>(motions.size() / 2);
    std::nth_element(motions.begin(), middle, motions.end());
    summary.set_median_motion_px(*middle);
  }
  return summary;
}

Result<PlanReport> MakePlanReport(const v1::Sortie& sortie, const v1::SortieManifest& manifest) {
  const v1::IngestSummary ingest = IngestSummaryFromManifest(manifest);
  TREM_ASSIGN_OR_RETURN(const std::vector<WindowPlan> windows, PlanWindows(sortie, ingest));
  PlanReport plan;
  plan.frame_count = ingest.frame_count();
  plan.usable_frame_count = ingest.usable_frame_count();
  plan.span_count = static_cast<std::uint32_t>(ingest.spans_size());
  plan.width_px = ingest.width_px();
  plan.height_px = ingest.height_px();
  plan.window_count = windows.size();
  plan.ingest_memory_bytes = IngestMemoryBytes();
  plan.composite_memory_bytes = CompositeMemoryBytes(sortie, 0);
  std::set<std::tuple<int, int, int, int>> rois;
  double disk_bytes = 0.0;
  for (const WindowPlan& window : windows) {
    const Roi& roi = window.roi_in_sensor;
    rois.insert({roi.x0, roi.y0, roi.x1, roi.y1});
    plan.enhance_memory_bytes =
        std::max(plan.enhance_memory_bytes, EnhanceMemoryBytes(sortie, ingest.width_px(), ingest.height_px(), window));
    // The ground that passes under the ROI, each part of it in about two emitted scenes.
    const double ratio = sortie.tre().ratio();
    const double width = roi.x1 - roi.x0;
    const double height = roi.y1 - roi.y0;
    const double travel = ingest.median_motion_px() * (window.frame_end - window.frame_begin);
    disk_bytes += 2.0 * ratio * ratio * (width * height + travel * std::max(width, height)) * kBytesPerCell;
  }
  plan.roi_count = rois.size();
  plan.disk_bytes = static_cast<std::uint64_t>(disk_bytes);
  return plan;
}

int RunPlanCommand(const std::string& sortie, const std::vector<std::string>& overrides, bool json) {
  CountInterrupts();
  int exit_code = kExitDone;
  const Result<PlanReport> plan = [&]() -> Result<PlanReport> {
    TREM_ASSIGN_OR_RETURN(const v1::Sortie spec, LoadSortie(sortie, overrides));
    TREM_ASSIGN_OR_RETURN(const v1::SortieManifest manifest, ReadManifest(sortie, overrides, &exit_code));
    return MakePlanReport(spec, manifest);
  }();
  if (InterruptSignal() != 0) return kExitSignalBase + InterruptSignal();
  if (!plan.ok()) {
    PrintError(plan.status().message());
    return exit_code == kExitDone ? ExitCodeOf(plan.status().code()) : exit_code;
  }
  if (json) {
    fmt::print("{}\n", DumpJson(PlanJson(*plan)));
  } else {
    PrintPlan(*plan);
  }
  return kExitDone;
}

}  // namespace trem
