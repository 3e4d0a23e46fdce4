// The half of Scheduler that knows jobs: how they start, unfold, end, and what is told about them.
#include <algorithm>

#include "coordinator/planning/task_plan.h"
#include "coordinator/scheduling/scheduler.h"
#include "mosaic/base/check.h"
#include "proto/codec/convert.h"

namespace trem {
namespace {

// Artefacts by name and digest, for comparing two results of one key.
bool SameOutputs(const v1::TaskResult& a, const v1::TaskResult& b) {
  return std::equal(a.outputs().begin(), a.outputs().end(), b.outputs().begin(), b.outputs().end(),
                    [](const v1::ArtefactRef& x, const v1::ArtefactRef& y) { return x.name() == y.name() && x.sha256() == y.sha256(); });
}

}  // namespace

Status Scheduler::Restore(const v1::LogEvent& event) {
  TREM_CHECK_MSG(restoring_, "Restore after the first Step");
  const auto number_of = [this](const std::string& job_id) -> Result<JobNumber> {
    const auto number = job_numbers_.find(job_id);
    if (number == job_numbers_.end()) return Corrupt("the log mentions job '" + job_id + "' before it was submitted");
    return number->second;
  };
  switch (event.body_case()) {
    case v1::LogEvent::kJobSubmitted: {
      const auto number = job_numbers_.find(event.job_submitted().job_id());
      const bool runs = number != job_numbers_.end() && jobs_.at(number->second).state == v1::JOB_RUNNING;
      if (!runs) StartJob(event.job_submitted().job_id(), event.job_submitted().sortie());
      break;
    }
    case v1::LogEvent::kJobCancelled: {
      TREM_ASSIGN_OR_RETURN(const JobNumber number, number_of(event.job_cancelled().job_id()));
      EndJob(number, v1::JOB_CANCELLED, {});
      break;
    }
    case v1::LogEvent::kJobFailed: {
      TREM_ASSIGN_OR_RETURN(const JobNumber number, number_of(event.job_failed().job_id()));
      EndJob(number, v1::JOB_FAILED, Status(static_cast<StatusCode>(event.job_failed().status_code()), event.job_failed().message()));
      break;
    }
    case v1::LogEvent::kTaskCommitted: {
      const v1::TaskCommitted& committed = event.task_committed();
      TREM_RETURN_IF_ERROR(CheckTaskResult(committed.kind(), committed.result()));
      handed_out_before_.erase(committed.task_key());
      Commit(committed.task_key(), {committed.result(), committed.elapsed_ms(), committed.peak_memory_bytes()});
      break;
    }
    case v1::LogEvent::kAttemptStarted: {
      std::uint32_t& newest = newest_attempts_[event.attempt_started().task_key()];
      newest = std::max(newest, event.attempt_started().attempt());
      handed_out_before_.insert(event.attempt_started().task_key());
      break;
    }
    case v1::LogEvent::kResultDiffered: {
      const auto finished = finished_.find(event.result_differed().task_key());
      if (finished == finished_.end()) break;  // Its artefacts are gone, so it was left out.
      for (const JobNumber number : finished->second.used_by) jobs_.at(number).graph->AddNote(event.result_differed().note());
      break;
    }
    default:
      return Corrupt("the log holds an event of an unknown kind; was it written by a newer version?");
  }
  effects_.clear();
  return {};
}

void Scheduler::On(const SubmitJobEvent& event) {
  const auto number = job_numbers_.find(event.job_id);
  if (number != job_numbers_.end()) {
    const v1::JobState state = jobs_.at(number->second).state;
    if (state == v1::JOB_RUNNING || state == v1::JOB_DONE) return;
  }
  v1::LogEvent log;
  log.mutable_job_submitted()->set_job_id(event.job_id);
  *log.mutable_job_submitted()->mutable_sortie() = event.sortie;
  Append(std::move(log));
  StartJob(event.job_id, event.sortie);
}

void Scheduler::On(const CancelJobEvent& event) {
  const auto number = job_numbers_.find(event.job_id);
  if (number == job_numbers_.end() || jobs_.at(number->second).state != v1::JOB_RUNNING) return;
  v1::LogEvent log;
  log.mutable_job_cancelled()->set_job_id(event.job_id);
  Append(std::move(log));
  EndJob(number->second, v1::JOB_CANCELLED, {});
}

void Scheduler::StartJob(const std::string& job_id, const v1::Sortie& sortie) {
  const JobNumber number = job_numbers_.try_emplace(job_id, job_numbers_.size()).first->second;
  Job& job = jobs_[number];
  job.id = job_id;
  job.state = v1::JOB_RUNNING;
  job.error = {};
  job.graph = std::make_unique<JobGraph>(job_id, sortie);
  effects_.push_back(JobChangedEffect{job_id});
  std::vector<std::pair<JobPlace, std::string>> completions;
  Want(number, job.graph->Start(), &completions);
  Deliver(std::move(completions));
}

void Scheduler::Want(JobNumber number, const PlannedTask& planned, std::vector<std::pair<JobPlace, std::string>>* finished_already) {
  const JobPlace place{number, planned.place};
  if (finished_.count(planned.key) > 0) {
    finished_already->push_back({place, planned.key});
    return;
  }
  const auto [found, is_new] = tasks_.try_emplace(planned.key);
  Task& task = found->second;
  if (is_new) {
    task.memory_bytes = planned.memory_bytes;
    task.wanted_by.insert(place);
    Enqueue(planned.key, task);
    return;
  }
  // The place of the first job that wants it is its place in the queue.
  const bool queued = task.state == TaskState::kReady;
  if (queued) Unqueue(planned.key, task);
  task.wanted_by.insert(place);
  if (queued) Enqueue(planned.key, task);
}

void Scheduler::Commit(const std::string& key, FinishedTask finished) {
  if (!finished_.try_emplace(key, Finished{std::move(finished), {}}).second) return;
  const auto found = tasks_.find(key);
  if (found == tasks_.end()) return;
  LeaveQueues(key, found->second);
  std::vector<std::pair<JobPlace, std::string>> completions;
  for (const JobPlace& place : found->second.wanted_by) completions.push_back({place, key});
  tasks_.erase(found);
  Deliver(std::move(completions));
}

// Tells jobs of results. What they unfold may be finished already (another job's, or from before a restart), hence the loop.
void Scheduler::Deliver(std::vector<std::pair<JobPlace, std::string>> completions) {
  for (std::size_t i = 0; i < completions.size(); ++i) {
    const auto [job_place, key] = completions[i];
    const auto& [number, place] = job_place;
    Job& job = jobs_.at(number);
    if (job.state != v1::JOB_RUNNING) continue;
    Finished& finished = finished_.at(key);
    finished.used_by.insert(number);
    const Result<std::vector<PlannedTask>> planned = job.graph->Finish(place, finished.task);
    if (!planned.ok()) {
      v1::LogEvent log;
      log.mutable_job_failed()->set_job_id(job.id);
      log.mutable_job_failed()->set_status_code(static_cast<std::uint32_t>(planned.status().code()));
      log.mutable_job_failed()->set_message(planned.status().message());
      Append(std::move(log));
      EndJob(number, v1::JOB_FAILED, planned.status());
      continue;
    }
    for (const PlannedTask& task : *planned) Want(number, task, &completions);
    if (job.graph->done()) {
      job.state = v1::JOB_DONE;
      effects_.push_back(JobChangedEffect{job.id});
    }
  }
}

// Ends a running job and lets go of its tasks; those that no other job wants are taken back.
void Scheduler::EndJob(JobNumber number, v1::JobState state, const Status& error) {
  Job& job = jobs_.at(number);
  if (job.state != v1::JOB_RUNNING) return;
  job.state = state;
  job.error = error;
  effects_.push_back(JobChangedEffect{job.id});
  for (const auto& [place, key] : job.graph->pending()) {
    const auto found = tasks_.find(key);
    if (found == tasks_.end()) continue;
    Task& task = found->second;
    const bool queued = task.state == TaskState::kReady;
    if (task.wanted_by.size() > 1) {
      if (queued) Unqueue(key, task);
      task.wanted_by.erase({number, place});
      if (queued) Enqueue(key, task);
      continue;
    }
    if (task.state == TaskState::kLeased && !task.worker_id.empty()) {
      Revoke(task.worker_id, {key, newest_attempts_.at(key)}, "job " + job.id + " has ended");
    }
    LeaveQueues(key, task);
    tasks_.erase(found);
  }
}

void Scheduler::FailJobsOf(const std::string& key, StatusCode code, const std::string& message) {
  const std::set<JobPlace> wanted_by = tasks_.at(key).wanted_by;
  for (const auto& [number, place] : wanted_by) {
    // What INGEST and EXPORT report is about the user's files and stands for itself.
    const bool says_itself = (place.kind == v1::INGEST || place.kind == v1::EXPORT) && code != StatusCode::kUnavailable;
    const std::string text = says_itself ? message : TaskTitle(place.kind, place.index) + ": " + message;
    v1::LogEvent log;
    log.mutable_job_failed()->set_job_id(jobs_.at(number).id);
    log.mutable_job_failed()->set_status_code(static_cast<std::uint32_t>(code));
    log.mutable_job_failed()->set_message(text);
    Append(std::move(log));
    EndJob(number, v1::JOB_FAILED, Status(code, text));
  }
}

void Scheduler::CompareWithCommitted(const Attempt& attempt, const v1::TaskResult& result) {
  const Finished& finished = finished_.at(attempt.task_key);
  if (SameOutputs(finished.task.result, result)) return;
  v1::LogEvent log;
  log.mutable_result_differed()->set_task_key(attempt.task_key);
  log.mutable_result_differed()->set_attempt(attempt.number);
  v1::Note* note = log.mutable_result_differed()->mutable_note();
  note->set_code("result_differs");
  note->set_subject(attempt.task_key);
  note->set_message(
      "attempt " + std::to_string(attempt.number) +
      " of this task gave other bytes than the committed result, which is kept; a worker's memory, disk or program may be faulty");
  note->set_severity(v1::WARNING);
  for (const JobNumber number : finished.used_by) {
    jobs_.at(number).graph->AddNote(*note);
    effects_.push_back(JobChangedEffect{jobs_.at(number).id});
  }
  effects_.push_back(LogEffect{"task " + attempt.task_key + ": " + note->message()});
  Append(std::move(log));
}

std::string Scheduler::TitleOf(const Task& task) const {
  const auto& [number, place] = *task.wanted_by.begin();
  return TaskTitle(place.kind, place.index) + " of job " + jobs_.at(number).id;
}

v1::JobStatus Scheduler::StatusOf(JobNumber number) const {
  const Job& job = jobs_.at(number);
  v1::JobStatus status;
  status.set_job_id(job.id);
  status.set_name(job.graph->sortie().name());
  status.set_state(job.state);
  status.set_error(job.error.message());
  status.set_error_code(static_cast<std::uint32_t>(job.error.code()));
  status.set_worker_count(static_cast<std::uint32_t>(workers_.size()));
  std::vector<std::pair<TaskPlace, double>> running;
  for (const auto& [worker_id, worker] : workers_) {
    for (const auto& [key, slot] : worker.slots) {
      const auto task = tasks_.find(key);
      if (!slot.live || task == tasks_.end()) continue;
      const auto place = task->second.wanted_by.lower_bound({number, TaskPlace{v1::TASK_KIND_UNSPECIFIED, 0}});
      if (place != task->second.wanted_by.end() && place->first == number) running.push_back({place->second, task->second.fraction});
    }
  }
  std::sort(running.begin(), running.end());
  job.graph->FillStatus(running, status.worker_count(), &status);
  if (job.state != v1::JOB_RUNNING && job.state != v1::JOB_DONE) status.set_eta_s(-1.0);
  const bool too_big = std::any_of(ready_.begin(), ready_.end(), [&](const auto& queue) {
    return !workers_.empty() && std::all_of(workers_.begin(), workers_.end(), [&](const auto& worker) {
      return worker.second.memory_bytes_max != 0 && worker.second.memory_bytes_max < queue.first;
    });
  });
  if (too_big && job.state == v1::JOB_RUNNING) {
    v1::Note* note = status.add_notes();
    note->set_code("waiting_for_memory");
    note->set_message("no connected worker has a memory limit that holds the next tasks; at least " +
                      std::to_string(ready_.rbegin()->first) + " bytes are needed");
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

std::vector<v1::WorkerStatus> Scheduler::WorkerStatuses() const {
  std::vector<v1::WorkerStatus> statuses;
  for (const auto& [worker_id, worker] : workers_) {
    v1::WorkerStatus status;
    status.set_worker_id(worker_id);
    status.set_host(worker.host);
    status.set_pid(worker.pid);
    for (const auto& [key, slot] : worker.slots) {
      v1::TaskAttempt* attempt = status.add_running();
      attempt->set_task_key(key);
      attempt->set_attempt(slot.attempt);
    }
    statuses.push_back(std::move(status));
  }
  return statuses;
}

const v1::Sortie* Scheduler::FindSortie(const std::string& job_id) const {
  const auto number = job_numbers_.find(job_id);
  return number == job_numbers_.end() ? nullptr : &jobs_.at(number->second).graph->sortie();
}

const v1::TaskResult* Scheduler::FindResult(const std::string& task_key) const {
  const auto finished = finished_.find(task_key);
  return finished == finished_.end() ? nullptr : &finished->second.task.result;
}

}  // namespace trem
