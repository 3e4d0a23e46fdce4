#include "coordinator/cli/doctor_command.h"

#include <fmt/format.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "coordinator/cli/child_process.h"
#include "coordinator/cli/job_report.h"
#include "coordinator/cli/run_command.h"
#include "coordinator/cli/terminal.h"
#include "mosaic/base/file.h"
#include "mosaic/base/version.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

constexpr const char* kInstallAgain = "install the three programs of one release in one folder";

Finding CheckProgram(const char* name) {
  const auto folder = ProgramFolder();
  if (!folder.ok()) return {name, false, folder.status().message(), kInstallAgain};
  const auto output = OutputOf({(*folder / name).string(), "--version"});
  if (!output.ok()) return {name, false, output.status().message(), kInstallAgain};
  const std::string version = output->substr(0, output->find('\n'));
  return {name, version.find(TREM_VERSION) != std::string::npos, version, kInstallAgain};
}

Finding CheckProcessor() {
  std::ifstream file("/proc/cpuinfo");
  std::string flags;
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with("flags")) flags = line + " ";
  }
  std::string best = "no vector instructions that the engine has a path for";
  for (const auto& [flag, name] : {std::pair("avx512f", "AVX-512"), std::pair("avx2", "AVX2"), std::pair("sse4_2", "SSE4")}) {
    if (flags.find(" " + std::string(flag) + " ") == std::string::npos) continue;
    best = name;
    break;
  }
  return {"processor", true, fmt::format("{} cores to use, {}", DefaultWorkerCount(), best), ""};
}

Finding CheckMemory() {
  const auto bytes = static_cast<double>(::sysconf(_SC_PHYS_PAGES)) * static_cast<double>(::sysconf(_SC_PAGESIZE));
  const double each = bytes / std::max(1, DefaultWorkerCount());
  return {"memory", each >= 1e9,
          fmt::format("{}, {} a core; a worker of default settings needs about 1 GB", FormatBytes(bytes), FormatBytes(each)),
          "start fewer workers than there are cores (--workers N), or plan smaller windows (--set windows.roi_px=121)"};
}

Finding CheckDisk(const fs::path& folder) {
  constexpr std::uint64_t kBytesWanted = 1'000'000'000;
  std::error_code error;
  const fs::space_info space = fs::space(folder, error);
  if (error) return {"disk", false, folder.string() + " cannot be looked at: " + error.message(), "look at its owner, mode and mount"};
  return JudgeDisk("disk", folder.string(), space.available, kBytesWanted);
}

Finding CheckDescriptors() {
  rlimit limit{};
  ::getrlimit(RLIMIT_NOFILE, &limit);
  return {"descriptors", limit.rlim_max >= 4096, fmt::format("at most {}; a coordinator needs one for each connection", limit.rlim_max),
          "raise the hard limit (ulimit -Hn, LimitNOFILE= of the unit)"};
}

}  // namespace

int RunDoctorCommand(const RemoteOptions& remote, const DoctorOptions& options) {
  std::error_code error;
  std::vector<Finding> findings = {
      {"trem", true, fmt::format("{} (engine revision {}, protocol {})", TREM_VERSION, kEngineRevision, kProtocolVersion), ""},
      CheckProgram("trem-coordinator"),
      CheckProgram("trem-worker"),
      CheckProcessor(),
      CheckMemory(),
      CheckDisk(fs::current_path(error)),
      CheckDisk(fs::temp_directory_path(error)),
      CheckDescriptors()};
  for (Finding& finding : CheckService(remote, options)) findings.push_back(std::move(finding));
  nlohmann::ordered_json json = nlohmann::ordered_json::array();
  for (Finding& finding : findings) {
    if (finding.is_good) finding.advice.clear();
    json.push_back({{"subject", finding.subject}, {"good", finding.is_good}, {"text", finding.text}, {"advice", finding.advice}});
    if (remote.json) continue;
    fmt::print("{:<5} {:<17} {}\n", finding.is_good ? "ok" : "CHECK", finding.subject, finding.text);
    if (!finding.advice.empty()) fmt::print("{:<23} -> {}\n", "", finding.advice);
  }
  if (remote.json) fmt::print("{}\n", DumpJson(json));
  return std::all_of(findings.begin(), findings.end(), [](const Finding& finding) { return finding.is_good; }) ? kExitDone : kExitFailed;
}

}  // namespace trem
