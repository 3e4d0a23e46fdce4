#include "coordinator/cli/doctor_command.h"

#include <fmt/format.h>
#include <sys/resource.h>
#include <sys/statvfs.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <thread>
#include <vector>

#include "coordinator/cli/child_process.h"
#include "coordinator/cli/client.h"
#include "coordinator/cli/job_report.h"
#include "coordinator/cli/run_command.h"
#include "coordinator/cli/terminal.h"
#include "mosaic/base/file.h"
#include "mosaic/base/version.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

struct Finding {
  std::string subject;
  bool is_good = true;
  std::string text;
};

// The first line that `program --version` prints.
Result<std::string> VersionOf(const fs::path& program) {
  std::string log = (fs::temp_directory_path() / "trem-doctor-XXXXXX").string();
  const int fd = ::mkstemp(log.data());
  if (fd < 0) return FromErrno("cannot make a file like " + log, errno);
  ::close(fd);
  const Result<pid_t> pid = StartChild({program.string(), "--version"}, log);
  int status = -1;
  if (pid.ok()) ::waitpid(*pid, &status, 0);
  const auto text = ReadFile(log, 65536);
  std::error_code ignored;
  fs::remove(log, ignored);
  if (!pid.ok()) return pid.status();
  if (status != 0) return Failed(program.string() + " " + DescribeExit(status));
  return text.ok() ? Result<std::string>(text->substr(0, text->find('\n'))) : text.status();
}

Finding CheckProgram(const char* name) {
  const auto folder = ProgramFolder();
  if (!folder.ok()) return {name, false, folder.status().message()};
  const auto version = VersionOf(*folder / name);
  if (!version.ok()) return {name, false, version.status().message()};
  return {name, version->find(TREM_VERSION) != std::string::npos, *version};
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
  return {"processor", true, fmt::format("{} cores to use, {}", DefaultWorkerCount(), best)};
}

Finding CheckMemory() {
  const auto bytes = static_cast<double>(::sysconf(_SC_PHYS_PAGES)) * static_cast<double>(::sysconf(_SC_PAGESIZE));
  const double each = bytes / std::max(1, DefaultWorkerCount());
  return {"memory", each >= 1e9, fmt::format("{}, {} a core; a worker of default settings needs about 1 GB", FormatBytes(bytes), FormatBytes(each))};
}

Finding CheckDisk(const fs::path& folder) {
  struct statvfs info {};
  if (::statvfs(folder.c_str(), &info) != 0) return {"disk", false, folder.string() + " cannot be looked at"};
  const double free = static_cast<double>(info.f_bavail) * static_cast<double>(info.f_frsize);
  return {"disk", free >= 1e9, fmt::format("{} free in {}", FormatBytes(free), folder.string())};
}

Finding CheckDescriptors() {
  rlimit limit{};
  ::getrlimit(RLIMIT_NOFILE, &limit);
  return {"descriptors", limit.rlim_max >= 4096, fmt::format("at most {}; a coordinator needs one for each connection", limit.rlim_max)};
}

std::vector<Finding> CheckService(const RemoteOptions& remote) {
  std::vector<Finding> findings;
  const Result<ChannelOptions> options = ChannelOptionsOf(remote.key, remote.coordinator_key);
  if (!options.ok()) {
    findings.push_back({"keys", false, options.status().message()});
    return findings;
  }
  findings.push_back({"keys", true, options->own_key ? options->own_key->name() + ", " + RoleName(options->own_key->role()) : "none"});
  if (remote.coordinator.empty()) return findings;
  Client client(remote.coordinator, std::chrono::seconds(5), [] { return Status(); }, {remote.key, remote.coordinator_key});
  v1::Envelope question;
  question.mutable_list_workers();
  const Result<v1::Envelope> workers = client.Ask(question);
  if (!workers.ok()) {
    findings.push_back({"coordinator", false, workers.status().message()});
    return findings;
  }
  const int count = workers->worker_list().workers_size();
  findings.push_back({"coordinator", true, fmt::format("{} answers; {} worker{}", remote.coordinator, count, count == 1 ? "" : "s")});
  question.mutable_get_data_lane();
  const Result<v1::Envelope> lane = client.Ask(question);
  findings.push_back({"data lane", lane.ok(), lane.ok() ? lane->data_lane().endpoint() : lane.status().message()});
  return findings;
}

}  // namespace

int RunDoctorCommand(const RemoteOptions& remote) {
  std::error_code error;
  std::vector<Finding> findings = {{"trem", true, fmt::format("{} (engine revision {}, protocol {})", TREM_VERSION, kEngineRevision, kProtocolVersion)},
                                   CheckProgram("trem-coordinator"), CheckProgram("trem-worker"), CheckProcessor(), CheckMemory(),
                                   CheckDisk(fs::current_path(error)), CheckDisk(fs::temp_directory_path(error)), CheckDescriptors()};
  for (Finding& finding : CheckService(remote)) findings.push_back(std::move(finding));
  nlohmann::ordered_json json = nlohmann::ordered_json::array();
  for (const Finding& finding : findings) {
    json.push_back({{"subject", finding.subject}, {"good", finding.is_good}, {"text", finding.text}});
    if (!remote.json) fmt::print("{:<5} {:<17} {}\n", finding.is_good ? "ok" : "CHECK", finding.subject, finding.text);
  }
  if (remote.json) fmt::print("{}\n", DumpJson(json));
  return std::all_of(findings.begin(), findings.end(), [](const Finding& finding) { return finding.is_good; }) ? kExitDone : kExitFailed;
}

}  // namespace trem
