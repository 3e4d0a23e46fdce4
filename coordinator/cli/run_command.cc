#include "coordinator/cli/run_command.h"

#include <fmt/format.h>
#include <sched.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <memory>
#include <optional>
#include <thread>

#include "coordinator/cli/child_process.h"
#include "coordinator/cli/client.h"
#include "coordinator/cli/interrupt.h"
#include "coordinator/cli/job_report.h"
#include "coordinator/cli/local_fleet.h"
#include "coordinator/cli/outputs.h"
#include "coordinator/cli/progress.h"
#include "coordinator/cli/terminal.h"
#include "coordinator/cli/work_folder.h"
#include "proto/codec/sortie_spec.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

using Clock = std::chrono::steady_clock;

// A busy machine may keep a coordinator that replays its log from answering for a while; one that died is noticed at once.
constexpr std::chrono::seconds kCoordinatorPatience{60};
// How often the job is asked after: a hundredth of the time it has taken so far, within these bounds.
constexpr std::chrono::milliseconds kPollIntervalMin{20};
constexpr std::chrono::milliseconds kPollIntervalMax{250};
constexpr std::size_t kWarningLinesMax = 10;

// What is known of a run so far; the report is made of it, whatever happens.
struct RunState {
  v1::JobStatus job;
  std::vector<PublishedFile> files;
  fs::path work_folder;
  bool work_folder_is_left = false;
  double elapsed_s = 0.0;
};

fs::path WorkFolderPath(const RunOptions& options) {
  fs::path path = options.work_folder;
  if (path.empty()) {
    path = options.output;
    path += ".work";
  }
  return fs::absolute(path).lexically_normal();
}

// The mosaic must not become one of the frames of the next run.
Status CheckOutputIsNotInSource(const fs::path& output, const v1::Sortie& sortie) {
  std::error_code error;
  const fs::path source = sortie.source().path();
  if (!fs::is_directory(source, error)) {
    if (fs::exists(output, error) && fs::equivalent(output, source, error)) {
      return InvalidInput("output " + output.string() + " is the source itself; choose another -o");
    }
    return {};
  }
  if (fs::equivalent(source, fs::absolute(output).parent_path(), error)) {
    return InvalidInput("output " + output.string() + " lies in the folder of the frames, " + source.string() +
                        ", where it would be taken for a frame; choose another folder with -o");
  }
  return {};
}

Status JobFailure(const v1::JobStatus& job) {
  const auto code = job.error_code();
  const bool known = code > static_cast<std::uint32_t>(StatusCode::kOk) && code <= static_cast<std::uint32_t>(StatusCode::kFailed);
  StatusCode status_code = known ? static_cast<StatusCode>(code) : StatusCode::kFailed;
  // Exit code 4 is for a coordinator that does not answer; this one did.
  if (status_code == StatusCode::kUnavailable) status_code = StatusCode::kFailed;
  return {status_code, job.error().empty() ? "the job was cancelled" : job.error()};
}

Status RunJob(const RunOptions& options, const v1::Sortie& sortie, const std::string& job_id, Client* client, RunState* state) {
  ProgressDisplay display(ProgressDisplay::ModeFor(options.quiet));
  const auto start = Clock::now();
  // A job of this id that was interrupted or failed is taken up again; tasks that it finished are not repeated.
  TREM_ASSIGN_OR_RETURN(state->job, client->Submit(job_id, sortie));
  for (;;) {
    display.Show(state->job);
    if (state->job.state() == v1::JOB_DONE || state->job.state() == v1::JOB_DONE_IN_PART) return {};
    if (state->job.state() == v1::JOB_FAILED || state->job.state() == v1::JOB_CANCELLED) return JobFailure(state->job);
    const auto elapsed = std::chrono::duration_cast<std::chrono::milliseconds>(Clock::now() - start);
    TREM_RETURN_IF_ERROR(client->Pause(std::clamp(elapsed / 100, kPollIntervalMin, kPollIntervalMax)));
    TREM_ASSIGN_OR_RETURN(state->job, client->GetJob(state->job.job_id()));
  }
}

// Everything between the start of the processes and their end.
Status RunWithFleet(const RunOptions& options, const v1::Sortie& sortie, const std::string& job_id, RunState* state) {
  TREM_ASSIGN_OR_RETURN(const fs::path programs, ProgramFolder());
  TREM_ASSIGN_OR_RETURN(const std::unique_ptr<LocalFleet> fleet, LocalFleet::Start({programs, state->work_folder, options.worker_count}));
  Client client(fleet->endpoint(), kCoordinatorPatience, [&]() -> Status {
    if (InterruptSignal() != 0) return Cancelled("interrupted");
    return fleet->Supervise();
  });
  Status status = RunJob(options, sortie, job_id, &client, state);
  // A local coordinator that is silent for so long is a failed run, not an address that the user got wrong.
  if (status.code() == StatusCode::kUnavailable) {
    status = Failed(status.message() + "; see " + (state->work_folder / "logs" / "coordinator.log").string());
  }
  fleet->Stop([&] { client.SendShutdown(); }, [] { return InterruptCount() > 1; });
  return status;
}

// Only the input's faults are known before anything was computed; then the work folder holds nothing that a second try could use.
bool NothingToResume(const Status& status, const v1::JobStatus& job) {
  if (ExitCodeOf(status.code()) != kExitInvalidInput) return false;
  return std::none_of(job.stages().begin(), job.stages().end(),
                      [](const v1::StageStatus& stage) { return stage.kind() == v1::ENHANCE && stage.done() > 0; });
}

Status Run(const RunOptions& options, RunState* state) {
  TREM_ASSIGN_OR_RETURN(const v1::Sortie sortie, LoadSortie(options.sortie, options.overrides));
  TREM_RETURN_IF_ERROR(CheckOutput(options.output));
  TREM_RETURN_IF_ERROR(CheckOutputIsNotInSource(options.output, sortie));
  TREM_ASSIGN_OR_RETURN(const std::string job_id, RunJobId(sortie));
  TREM_ASSIGN_OR_RETURN(WorkFolder work, WorkFolder::Open(WorkFolderPath(options)));
  state->work_folder = work.path();
  state->work_folder_is_left = true;
  Status status = RunWithFleet(options, sortie, job_id, state);
  if (status.ok()) {
    TREM_ASSIGN_OR_RETURN(const ArtefactStore store, ArtefactStore::Open(work.path() / "store"));
    Result<std::vector<PublishedFile>> files = PublishOutputs(state->job, store, options.output, work.path());
    status = files.status();
    if (files.ok()) state->files = std::move(files).value();
  }
  if (status.ok() ? !options.keep_work : work.is_new() && NothingToResume(status, state->job)) {
    work.Remove();
    state->work_folder_is_left = false;
  }
  return status;
}

void PrintJson(const Status& status, int exit_code, const RunState& state) {
  nlohmann::ordered_json json = JobJson(state.job);
  if (!status.ok()) {
    json["state"] = InterruptSignal() != 0 ? "interrupted" : "failed";
    json["error"] = {{"code", ToString(status.code())}, {"message", status.message()}};
    json["outputs"] = nlohmann::ordered_json::array();
  } else {
    json["outputs"] = nlohmann::ordered_json::array();
    for (const PublishedFile& file : state.files) {
      json["outputs"].push_back({{"name", file.name}, {"path", file.path.string()}, {"bytes", file.bytes}, {"sha256", file.sha256}});
    }
  }
  json["elapsed_s"] = state.elapsed_s;
  json["work_folder"] = state.work_folder_is_left ? nlohmann::ordered_json(state.work_folder.string()) : nlohmann::ordered_json();
  json["exit_code"] = exit_code;
  fmt::print("{}\n", DumpJson(json));
}

void PrintSummary(const RunState& state) {
  for (const PublishedFile& file : state.files)
    fmt::print("{:>10}  {}\n", FormatBytes(static_cast<double>(file.bytes)), file.path.string());
  fmt::print("done {}in {}", state.job.state() == v1::JOB_DONE_IN_PART ? "in part " : "", FormatDuration(state.elapsed_s));
  if (state.job.peak_memory_bytes() > 0) {
    fmt::print("; a worker needed at most {}", FormatBytes(static_cast<double>(state.job.peak_memory_bytes())));
  }
  fmt::print("\n");
}

}  // namespace

int DefaultWorkerCount() {
  cpu_set_t set;
  if (::sched_getaffinity(0, sizeof(set), &set) == 0) return std::max(1, CPU_COUNT(&set));
  return static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
}

int RunRunCommand(const RunOptions& options) {
  CountInterrupts();
  const auto start = Clock::now();
  RunState state;
  const Status status = Run(options, &state);
  state.elapsed_s = std::chrono::duration<double>(Clock::now() - start).count();
  const bool interrupted = !status.ok() && InterruptSignal() != 0;
  const bool in_part = status.ok() && state.job.state() == v1::JOB_DONE_IN_PART;
  int exit_code = interrupted ? kExitSignalBase + InterruptSignal() : ExitCodeOf(status.code());
  if (in_part) exit_code = kExitDoneInPart;
  // After invalid input the same command would fail the same way.
  const std::string kept = exit_code == kExitInvalidInput ? "; what was computed so far is kept in " + state.work_folder.string()
                                                          : "; the same command resumes (kept in " + state.work_folder.string() + ")";
  const std::string resume = state.work_folder_is_left ? kept : std::string();
  if (interrupted) {
    PrintError("interrupted" + resume);
  } else if (!status.ok()) {
    PrintError(status.message() + resume);
  } else {
    for (const std::string& line : WarningLines(state.job, kWarningLinesMax)) PrintWarning(line);
    if (!options.json && !options.quiet) PrintSummary(state);
  }
  if (options.json) PrintJson(status, exit_code, state);
  return exit_code;
}

}  // namespace trem
