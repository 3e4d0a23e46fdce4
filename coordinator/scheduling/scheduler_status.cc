// The part of Scheduler that tells how things stand.
#include <algorithm>

#include "coordinator/planning/task_plan.h"
#include "coordinator/scheduling/scheduler.h"

namespace trem {

std::string Scheduler::TitleOf(const Task& task) const {
  const JobPlace& place = task.wanted_by.front();
  return TaskTitle(place.place.kind, place.place.index) + " of job " + jobs_.at(place.job).id;
}

// Whether some task of the job fits no connected worker.
bool Scheduler::WaitsForMemory(const Job& job) const {
  return job.state == v1::JOB_RUNNING && !memory_limits_.empty() && !job.memory_wanted.empty() &&
         job.memory_wanted.rbegin()->first > *memory_limits_.rbegin();
}

v1::JobStatus Scheduler::StatusOf(JobNumber number) const {
  const Job& job = jobs_.at(number);
  v1::JobStatus status;
  status.set_job_id(job.id);
  status.set_name(job.graph->sortie().name());
  status.set_user(job.user);
  status.set_priority(job.priority);
  status.set_state(job.state);
  status.set_error(job.error.message());
  status.set_error_code(static_cast<std::uint32_t>(job.error.code()));
  status.set_worker_count(static_cast<std::uint32_t>(workers_.size()));
  std::vector<std::pair<TaskPlace, double>> running;
  for (const auto& [place, index] : job.live) {
    double fraction = 0.0;
    bool is_held = false;  // Not before the worker that held it before a restart has come back.
    for (const Lease& lease : leases_.at(index)) {
      fraction = std::max(fraction, lease.fraction);
      is_held |= !lease.worker_id.empty();
    }
    if (is_held) running.push_back({place, fraction});
  }
  job.graph->FillStatus(running, status.worker_count(), &status);
  if (job.state == v1::JOB_FAILED || job.state == v1::JOB_CANCELLED) {
    status.set_eta_s(-1.0);
    status.set_eta_low_s(-1.0);
    status.set_eta_high_s(-1.0);
  }
  if (WaitsForMemory(job)) {
    v1::Note* note = status.add_notes();
    note->set_code("waiting_for_memory");
    note->set_message("no connected worker has a memory limit that holds all of its tasks; at least " +
                      std::to_string(job.memory_wanted.rbegin()->first) + " bytes are needed");
    note->set_severity(v1::WARNING);
  }
  return status;
}

std::optional<v1::JobStatus> Scheduler::JobStatus(const std::string& job_id) const {
  const auto number = job_numbers_.find(job_id);
  if (number == job_numbers_.end()) return std::nullopt;
  return StatusOf(number->second);
}

std::vector<v1::JobStatus> Scheduler::JobStatuses() const {
  std::vector<v1::JobStatus> statuses;
  for (const auto& [number, job] : jobs_) statuses.push_back(StatusOf(number));
  return statuses;
}

void Scheduler::FillRunning(const std::string& key, std::uint32_t attempt, v1::RunningTask* running) const {
  running->set_task_key(key);
  running->set_attempt(attempt);
  const TaskIndex index = FindTask(key);
  if (index == kNoTask) return;
  if (const auto& wanted_by = tasks_[index].wanted_by; !wanted_by.empty()) {
    running->set_job_id(jobs_.at(wanted_by.front().job).id);
    running->set_title(TaskTitle(wanted_by.front().place.kind, wanted_by.front().place.index));
  }
  const auto leases = leases_.find(index);
  if (leases == leases_.end()) return;
  for (const Lease& lease : leases->second) {
    if (lease.attempt != attempt) continue;
    running->set_fraction(lease.fraction);
    running->set_running_ms(static_cast<std::uint64_t>(now_ms_ - lease.started_ms));
  }
}

std::vector<Scheduler::TaskUse> Scheduler::UsesOf(const std::string& task_key) const {
  std::vector<TaskUse> uses;
  const TaskIndex index = FindTask(task_key);
  if (index == kNoTask) return uses;
  const Task& task = tasks_[index];
  for (const JobPlace& place : task.finished != nullptr ? task.finished->used_by : task.wanted_by) {
    uses.push_back({jobs_.at(place.job).id, TaskTitle(place.place.kind, place.place.index)});
  }
  return uses;
}

std::vector<v1::WorkerStatus> Scheduler::WorkerStatuses() const {
  std::vector<v1::WorkerStatus> statuses;
  for (const auto& [worker_id, worker] : workers_) {
    v1::WorkerStatus status;
    status.set_worker_id(worker_id);
    status.set_host(worker.host);
    status.set_pid(worker.pid);
    status.set_draining(worker.is_draining);
    status.set_credit(worker.credit);
    status.set_memory_bytes_max(worker.memory_bytes_max);
    for (const auto& [key, slot] : worker.slots) {
      v1::TaskAttempt* attempt = status.add_running();
      attempt->set_task_key(key);
      attempt->set_attempt(slot.attempt);
      if (slot.live) FillRunning(key, slot.attempt, status.add_tasks());
    }
    statuses.push_back(std::move(status));
  }
  return statuses;
}

const v1::Sortie* Scheduler::FindSortie(const std::string& job_id) const {
  const auto number = job_numbers_.find(job_id);
  return number == job_numbers_.end() ? nullptr : &jobs_.at(number->second).graph->sortie();
}

std::uint32_t Scheduler::RunningJobCount(const std::string& user) const {
  return static_cast<std::uint32_t>(std::count_if(
      jobs_.begin(), jobs_.end(), [&](const auto& job) { return job.second.state == v1::JOB_RUNNING && job.second.user == user; }));
}

const v1::TaskResult* Scheduler::FindResult(const std::string& task_key) const {
  const TaskIndex index = FindTask(task_key);
  return index == kNoTask || tasks_[index].finished == nullptr ? nullptr : &tasks_[index].finished->task->result;
}

void Scheduler::VisitInUse(const std::function<void(const v1::ArtefactRef&)>& visit,
                           const std::function<void(const v1::Sortie&)>& visit_sortie) const {
  for (const Task& task : tasks_) {
    for (const std::unique_ptr<Finished>* finished : {&task.finished, &task.damaged}) {
      if (*finished == nullptr) continue;
      for (const v1::ArtefactRef& output : (*finished)->task->result.outputs()) visit(output);
    }
  }
  for (const auto& [number, job] : jobs_) visit_sortie(job.graph->sortie());
}

}  // namespace trem
