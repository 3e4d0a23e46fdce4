#include "coordinator/cli/top_screen.h"

#include <fmt/format.h>

#include <algorithm>
#include <numeric>

#include "coordinator/cli/job_report.h"
#include "coordinator/cli/progress.h"
#include "coordinator/cli/remote.h"
#include "coordinator/cli/terminal.h"

namespace trem {
namespace {

bool IsRunning(const v1::JobStatus& job) { return job.state() == v1::JOB_RUNNING; }

std::string Headline(const FleetView& view) {
  std::size_t running = 0, failed = 0, waiting = 0;
  for (const v1::JobStatus& job : view.jobs) {
    running += IsRunning(job) ? 1 : 0;
    failed += job.state() == v1::JOB_FAILED ? 1 : 0;
    for (const v1::StageStatus& stage : job.stages()) {
      if (!IsRunning(job) || stage.done() >= stage.total()) continue;
      waiting += stage.total() - std::min(stage.total(), stage.done() + stage.running());
      break;  // Later stages wait for this one.
    }
  }
  const auto busy =
      std::count_if(view.workers.begin(), view.workers.end(), [](const v1::WorkerStatus& worker) { return worker.running_size() > 0; });
  std::string line = fmt::format("{}: {} running, {} other jobs", view.coordinator, running, view.jobs.size() - running);
  if (failed > 0) line += fmt::format(" ({} failed)", failed);
  line += fmt::format("; {} workers, {} busy; {} tasks wait", view.workers.size(), busy, waiting);
  if (view.tasks_per_s >= 0.0) line += fmt::format("; {:.1f} tasks/s", view.tasks_per_s);
  return line;
}

std::string JobLine(const v1::JobStatus& job) {
  return fmt::format("{:<40} {:<12} {:>4}  {:<12} {:>4.0f}%  {:<20} {}", job.job_id(), ForTerminal(job.user()), job.priority(),
                     JobStateName(job.state()), std::max(0.0, job.fraction()) * 100.0, IsRunning(job) ? StageText(job) : "",
                     TimeLeftText(job));
}

std::string WorkerLine(const v1::WorkerStatus& worker) {
  std::string line = fmt::format("{:<40} {:>6.1f} s  {}", worker.worker_id(), static_cast<double>(worker.last_seen_ms_ago()) / 1000.0,
                                 worker.draining() ? "drains " : "");
  if (worker.tasks().empty()) return line + (worker.running_size() > 0 ? "lets go of a task" : "idle");
  for (const v1::RunningTask& task : worker.tasks()) {
    line += fmt::format("{} of {} #{} {:.0f}% {}  ", ForTerminal(task.title()), task.job_id(), task.attempt(), task.fraction() * 100.0,
                        FormatDuration(static_cast<double>(task.running_ms()) / 1000.0));
  }
  return line;
}

// As many of `lines` as fit, and how many do not.
void AddSome(const std::vector<std::string>& lines, std::size_t room, std::vector<std::string>* screen) {
  const std::size_t shown = lines.size() <= room ? lines.size() : (room == 0 ? 0 : room - 1);
  screen->insert(screen->end(), lines.begin(), lines.begin() + static_cast<std::ptrdiff_t>(shown));
  if (shown < lines.size() && room > 0) screen->push_back(fmt::format("... and {} more", lines.size() - shown));
}

}  // namespace

std::uint64_t TasksDone(const std::vector<v1::JobStatus>& jobs) {
  std::uint64_t count = 0;
  for (const v1::JobStatus& job : jobs) {
    for (const v1::StageStatus& stage : job.stages()) count += stage.done();
  }
  return count;
}

std::vector<std::string> TopScreen(const FleetView& view, int columns, int rows) {
  std::vector<const v1::JobStatus*> jobs;
  for (const v1::JobStatus& job : view.jobs) jobs.push_back(&job);
  std::reverse(jobs.begin(), jobs.end());
  std::stable_sort(jobs.begin(), jobs.end(), [](const v1::JobStatus* a, const v1::JobStatus* b) {
    if (IsRunning(*a) != IsRunning(*b)) return IsRunning(*a);
    return IsRunning(*a) && a->priority() > b->priority();
  });
  std::vector<const v1::WorkerStatus*> workers;
  for (const v1::WorkerStatus& worker : view.workers) workers.push_back(&worker);
  std::stable_sort(workers.begin(), workers.end(),
                   [](const v1::WorkerStatus* a, const v1::WorkerStatus* b) { return a->running_size() > b->running_size(); });
  std::vector<std::string> job_lines, worker_lines;
  for (const v1::JobStatus* job : jobs) job_lines.push_back(JobLine(*job));
  for (const v1::WorkerStatus* worker : workers) worker_lines.push_back(WorkerLine(*worker));

  constexpr std::size_t kHeads = 4;  // Headline, two titles, an empty line.
  const std::size_t room =
      rows <= 0 ? job_lines.size() + worker_lines.size() : static_cast<std::size_t>(std::max(0, rows - static_cast<int>(kHeads)));
  // Half for each, and what one does not need for the other.
  const std::size_t job_room = std::max(room / 2, room - std::min(room, worker_lines.size()));
  std::vector<std::string> screen = {
      Headline(view), fmt::format("{:<40} {:<12} {:>4}  {:<12} {:>5}  {:<20} {}", "JOB", "USER", "PRIO", "STATE", "DONE", "STAGE", "TIME")};
  AddSome(job_lines, std::min(job_room, job_lines.size()), &screen);
  screen.emplace_back();
  screen.push_back(fmt::format("{:<40} {:>8}  {}", "WORKER", "SEEN", "TASK"));
  AddSome(worker_lines, room - std::min({room, job_room, job_lines.size()}), &screen);
  for (std::string& line : screen) {
    if (columns > 0 && line.size() > static_cast<std::size_t>(columns)) line.resize(static_cast<std::size_t>(columns));
    line.erase(line.find_last_not_of(' ') + 1);
  }
  return screen;
}

}  // namespace trem
