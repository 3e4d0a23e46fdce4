#include "coordinator/cli/operator_commands.h"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <ctime>
#include <nlohmann/json.hpp>
#include <optional>

#include "coordinator/cli/job_report.h"
#include "coordinator/cli/remote.h"
#include "coordinator/cli/terminal.h"
#include "coordinator/cli/top_screen.h"
#include "proto/codec/envelope.h"

namespace trem {
namespace {

using nlohmann::ordered_json;
using std::chrono::milliseconds;

constexpr milliseconds kFollowInterval{1000};
constexpr milliseconds kBackupInterval{200};

// "2026-01-31T12:00:00.123Z".
std::string UtcText(std::uint64_t time_ms) {
  return fmt::format("{:%Y-%m-%dT%H:%M:%S}.{:03}Z", fmt::gmtime(static_cast<std::time_t>(time_ms / 1000)), time_ms % 1000);
}

void PrintLine(const RemoteOptions& remote, const v1::LogLine& line) {
  if (remote.json) {
    const ordered_json json = {
        {"number", line.number()},    {"time", UtcText(line.time_ms())}, {"level", line.warning() ? "warning" : "info"},
        {"task", line.task()},        {"task_key", line.task_key()},     {"attempt", line.attempt()},
        {"worker", line.worker_id()}, {"message", line.text()}};
    fmt::print("{}\n", json.dump(-1, ' ', false, ordered_json::error_handler_t::replace));
    return;
  }
  std::string text = UtcText(line.time_ms()) + (line.warning() ? " warning" : " info");
  if (!line.task().empty()) text += " [" + line.task() + (line.attempt() > 0 ? fmt::format(" #{}", line.attempt()) : "") + "]";
  text += " " + line.text();
  if (!line.worker_id().empty()) text += " worker=" + line.worker_id();
  fmt::print("{}\n", ForTerminal(std::move(text)));
}

// Prints what there is after `*after`.
Status PrintPages(const RemoteOptions& remote, const LogsOptions& options, Client* client, std::uint64_t* after) {
  for (;;) {
    v1::Envelope question;
    v1::GetLog* get = question.mutable_get_log();
    get->set_job_id(options.job_id);
    get->set_task(options.task);
    get->set_attempt(options.attempt);
    get->set_worker_id(options.worker_id);
    get->set_after(*after);
    get->set_newest(options.newest && *after == 0);
    TREM_ASSIGN_OR_RETURN(const v1::Envelope answer, client->Ask(question));
    for (const v1::LogLine& line : answer.log_page().lines()) PrintLine(remote, line);
    std::fflush(stdout);
    *after = answer.log_page().next_after();
    if (answer.log_page().is_last()) return {};
  }
}

Status FollowLog(const RemoteOptions& remote, const LogsOptions& options) {
  TREM_RETURN_IF_ERROR(CheckJobId(options.job_id));
  Client client = MakeClient(remote);
  Absence absence;
  std::uint64_t after = 0;
  for (;;) {
    bool is_running = false;
    Status asked;
    if (options.follow) {
      const Result<v1::JobStatus> job = client.GetJob(options.job_id);
      asked = job.status();
      is_running = job.ok() && job->state() == v1::JOB_RUNNING;
    }
    if (asked.ok()) asked = PrintPages(remote, options, &client, &after);
    if (options.follow && absence.Outlasts(asked, &client)) continue;
    TREM_RETURN_IF_ERROR(asked);
    if (!is_running) return {};
    TREM_RETURN_IF_ERROR(client.Pause(kFollowInterval));
  }
}

Result<FleetView> Look(const RemoteOptions& remote, Client* client) {
  FleetView view;
  view.coordinator = remote.coordinator;
  v1::Envelope question;
  question.mutable_list_jobs();
  TREM_ASSIGN_OR_RETURN(const v1::Envelope jobs, client->Ask(question));
  question.mutable_list_workers();
  TREM_ASSIGN_OR_RETURN(const v1::Envelope workers, client->Ask(question));
  view.jobs.assign(jobs.job_list().jobs().begin(), jobs.job_list().jobs().end());
  view.workers.assign(workers.worker_list().workers().begin(), workers.worker_list().workers().end());
  view.tasks_done = TasksDone(view.jobs);
  return view;
}

ordered_json ViewJson(const FleetView& view) {
  ordered_json json = {{"tasks_done", view.tasks_done}, {"jobs", ordered_json::array()}, {"workers", ordered_json::array()}};
  for (const v1::JobStatus& job : view.jobs) json["jobs"].push_back(JobJson(job));
  for (const v1::WorkerStatus& worker : view.workers) {
    ordered_json tasks = ordered_json::array();
    for (const v1::RunningTask& task : worker.tasks()) {
      tasks.push_back({{"task_key", task.task_key()},
                       {"task", task.title()},
                       {"job_id", task.job_id()},
                       {"attempt", task.attempt()},
                       {"fraction", task.fraction()},
                       {"running_ms", task.running_ms()}});
    }
    json["workers"].push_back({{"worker_id", worker.worker_id()},
                               {"host", worker.host()},
                               {"draining", worker.draining()},
                               {"last_seen_ms_ago", worker.last_seen_ms_ago()},
                               {"tasks", tasks}});
  }
  return json;
}

Status ShowTop(const RemoteOptions& remote, const TopOptions& options) {
  const bool once = options.once || remote.json || ::isatty(STDOUT_FILENO) == 0;
  Client client = MakeClient(remote);
  Absence absence;
  std::optional<std::pair<std::chrono::steady_clock::time_point, std::uint64_t>> before;
  for (;;) {
    const auto now = std::chrono::steady_clock::now();
    Result<FleetView> looked = Look(remote, &client);
    if (!once && absence.Outlasts(looked.status(), &client)) continue;
    TREM_ASSIGN_OR_RETURN(FleetView view, std::move(looked));
    // Results that were lost are not done any more: then the rate is not known.
    if (before && view.tasks_done >= before->second) {
      view.tasks_per_s = static_cast<double>(view.tasks_done - before->second) / std::chrono::duration<double>(now - before->first).count();
    }
    before = {now, view.tasks_done};
    winsize size{};
    const bool has_size = !once && ::ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_row > 0;
    if (remote.json) {
      fmt::print("{}\n", DumpJson(ViewJson(view)));
    } else {
      if (!once) fmt::print("\x1b[H\x1b[2J");
      for (const std::string& line : TopScreen(view, has_size ? size.ws_col : 0, has_size ? size.ws_row - 1 : 0)) fmt::print("{}\n", line);
    }
    std::fflush(stdout);
    if (once) return {};
    TREM_RETURN_IF_ERROR(client.Pause(milliseconds(static_cast<std::int64_t>(options.interval_s * 1000.0))));
  }
}

Result<v1::BackupStatus> MakeBackup(const RemoteOptions& remote, const std::string& name) {
  if (!IsJobId(name)) return InvalidInput("'" + name + "' is not a name for a backup; expected 1 to 64 of a-z, 0-9 and '-'");
  Client client = MakeClient(remote);
  v1::Envelope question;
  question.mutable_backup()->set_backup_id(name);
  for (;;) {
    TREM_ASSIGN_OR_RETURN(const v1::Envelope answer, client.Ask(question));
    if (answer.backup_status().fraction() >= 1.0) return answer.backup_status();
    TREM_RETURN_IF_ERROR(client.Pause(kBackupInterval));
  }
}

}  // namespace

int RunLogsCommand(const RemoteOptions& remote, const LogsOptions& options) {
  const Status status = FollowLog(remote, options);
  return status.ok() ? kExitDone : ReportFailure(status);
}

int RunTopCommand(const RemoteOptions& remote, const TopOptions& options) {
  const Status status = ShowTop(remote, options);
  return status.ok() ? kExitDone : ReportFailure(status);
}

int RunBackupCommand(const RemoteOptions& remote, std::string name) {
  if (name.empty()) name = fmt::format("events-{:%Y%m%d-%H%M%S}", fmt::gmtime(std::time(nullptr)));
  const Result<v1::BackupStatus> backup = MakeBackup(remote, name);
  if (!backup.ok()) return ReportFailure(backup.status());
  if (remote.json) {
    const ordered_json json = {
        {"name", backup->backup_id()}, {"path", backup->path()}, {"bytes", backup->bytes()}, {"sha256", backup->sha256()}};
    fmt::print("{}\n", DumpJson(json));
  } else {
    fmt::print("{}  {}  sha256 {}\n", ForTerminal(backup->path()), FormatBytes(static_cast<double>(backup->bytes())), backup->sha256());
  }
  return kExitDone;
}

}  // namespace trem
