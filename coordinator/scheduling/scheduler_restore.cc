// The part of Scheduler that turns a log into a state and a state into a log.
#include <algorithm>

#include "coordinator/planning/task_plan.h"
#include "coordinator/scheduling/planted_fault.h"
#include "coordinator/scheduling/scheduler.h"
#include "mosaic/base/check.h"

namespace trem {

Status Scheduler::Restore(const v1::LogEvent& event) {
  TREM_CHECK_MSG(restoring_, "Restore after the first Step");
  const auto number_of = [this](const std::string& job_id) -> Result<JobNumber> {
    const auto number = job_numbers_.find(job_id);
    if (number == job_numbers_.end()) return Corrupt("the log mentions job '" + job_id.substr(0, 80) + "' before it was submitted");
    return number->second;
  };
  switch (event.body_case()) {
    case v1::LogEvent::kJobSubmitted: {
      const auto number = job_numbers_.find(event.job_submitted().job_id());
      const bool runs = number != job_numbers_.end() && jobs_.at(number->second).state == v1::JOB_RUNNING;
      if (!runs) StartJob(event.job_submitted());
      break;
    }
    case v1::LogEvent::kJobCancelled: {
      TREM_ASSIGN_OR_RETURN(const JobNumber number, number_of(event.job_cancelled().job_id()));
      EndJob(number, v1::JOB_CANCELLED, {});
      break;
    }
    case v1::LogEvent::kJobRemoved: {
      TREM_ASSIGN_OR_RETURN(const JobNumber number, number_of(event.job_removed().job_id()));
      EndJob(number, v1::JOB_CANCELLED, {});  // Its artefacts are gone, so it has not come to its end here.
      ForgetJob(number);
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
      const TaskIndex index = FindOrAddTask(committed.task_key());
      Task& task = tasks_[index];
      task.newest_attempt = std::max(task.newest_attempt, committed.attempt());
      if (task.state == TaskState::kFinished) break;
      if (!task.wanted_by.empty() && task.wanted_by.front().place.kind != committed.kind()) {
        return Corrupt("the log holds the result of an " + v1::TaskKind_Name(committed.kind()) + " task under the key of an " +
                       v1::TaskKind_Name(task.wanted_by.front().place.kind) + " task");
      }
      Commit(index, committed.kind(), {committed.result(), committed.elapsed_ms(), committed.peak_memory_bytes()});
      break;
    }
    case v1::LogEvent::kAttemptStarted: {
      if (TREM_PLANTED(kForgetsNumbersOnRestore)) break;
      Task& task = tasks_[FindOrAddTask(event.attempt_started().task_key())];
      task.newest_attempt = std::max(task.newest_attempt, event.attempt_started().attempt());
      task.was_handed_out = task.state != TaskState::kFinished;
      break;
    }
    case v1::LogEvent::kResultDiffered: {
      const TaskIndex index = FindTask(event.result_differed().task_key());
      if (index == kNoTask || tasks_[index].finished == nullptr) break;  // Its artefacts are gone, so it was left out.
      for (const JobPlace& place : tasks_[index].finished->used_by) jobs_.at(place.job).graph->AddNote(event.result_differed().note());
      differed_.insert_or_assign(event.result_differed().task_key(), event);
      break;
    }
    case v1::LogEvent::kTaskQuarantined: {
      const v1::TaskQuarantined& quarantined = event.task_quarantined();
      TREM_ASSIGN_OR_RETURN(const JobNumber number, number_of(quarantined.job_id()));
      const TaskIndex index = FindTask(quarantined.task_key());
      if (index == kNoTask) break;  // What comes before it runs again.
      const std::vector<JobPlace> wanted_by = tasks_[index].wanted_by;
      for (const JobPlace& place : wanted_by) {
        const Status reason(static_cast<StatusCode>(quarantined.status_code()), quarantined.message());
        if (reason.ok()) return Corrupt("a task was given up without a failure");
        if (place.place.kind != v1::ENHANCE && place.place.kind != v1::COMPOSITE) {
          return Corrupt("the log makes a hole of " + TaskTitle(place.place.kind, place.place.index) +
                         ", for which there is no substitute");
        }
        if (place.job == number) MakeHole(number, place.place, reason);
      }
      break;
    }
    case v1::LogEvent::kTaskInvalidated: {
      const TaskIndex index = FindTask(event.task_invalidated().task_key());
      if (index != kNoTask && tasks_[index].state == TaskState::kFinished) Invalidate(index);
      break;
    }
    default:
      return Corrupt("the log holds an event of an unknown kind; was it written by a newer version?");
  }
  effects_.clear();
  return {};
}

namespace {

// What a snapshot says of a task. Keys are never changed or removed.
struct TaskRecord {
  const std::string* key = nullptr;
  std::shared_ptr<const FinishedTask> finished;  // Null: known, and not done.
  std::uint32_t newest_attempt = 0;
  v1::TaskKind kind = v1::TASK_KIND_UNSPECIFIED;

  v1::LogEvent ToEvent() const {
    v1::LogEvent event;
    if (finished == nullptr) {
      event.mutable_attempt_started()->set_task_key(*key);
      event.mutable_attempt_started()->set_attempt(newest_attempt);
      return event;
    }
    v1::TaskCommitted* committed = event.mutable_task_committed();
    committed->set_task_key(*key);
    committed->set_kind(kind);
    committed->set_attempt(newest_attempt);
    *committed->mutable_result() = finished->result;
    committed->set_elapsed_ms(finished->elapsed_ms);
    committed->set_peak_memory_bytes(finished->peak_memory_bytes);
    return event;
  }
};

}  // namespace

// Results first: jobs then unfold as far as they are. Holes and ends follow each job, as they must.
std::function<std::optional<v1::LogEvent>()> Scheduler::BeginSnapshot() const {
  struct Cursor {
    std::vector<TaskRecord> tasks;
    std::vector<v1::LogEvent> rest;
    std::size_t next = 0;
  };
  std::vector<const Task*> damaged;
  const auto cursor = std::make_shared<Cursor>();
  cursor->tasks.reserve(tasks_.size());
  for (const Task& task : tasks_) {
    if (task.newest_attempt == 0 && task.finished == nullptr) continue;
    if (task.finished == nullptr && TREM_PLANTED(kForgetsNumbersInSnapshot)) continue;
    if (task.finished != nullptr && TREM_PLANTED(kForgetsResultsInSnapshot)) continue;
    TaskRecord& record = cursor->tasks.emplace_back();
    record.key = &task.key;
    record.newest_attempt = task.newest_attempt;
    // What was built on a result that is being made again stands.
    const Finished* finished = task.finished != nullptr ? task.finished.get() : task.damaged.get();
    if (finished == nullptr) continue;
    record.finished = finished->task;
    record.kind = finished->kind;
    if (task.damaged != nullptr) damaged.push_back(&task);
  }
  SnapshotJobs(&cursor->rest);
  for (const Task* task : damaged) {
    cursor->rest.emplace_back().mutable_task_invalidated()->set_task_key(task->key);
    v1::AttemptStarted* started = cursor->rest.emplace_back().mutable_attempt_started();
    started->set_task_key(task->key);
    started->set_attempt(task->newest_attempt);
  }
  return [cursor]() -> std::optional<v1::LogEvent> {
    const std::size_t i = cursor->next++;
    if (i < cursor->tasks.size()) {
      v1::LogEvent event = cursor->tasks[i].ToEvent();
      cursor->tasks[i].finished.reset();
      return event;
    }
    if (i < cursor->tasks.size() + cursor->rest.size()) return std::move(cursor->rest[i - cursor->tasks.size()]);
    return std::nullopt;
  };
}

std::vector<v1::LogEvent> Scheduler::Snapshot() const {
  std::vector<v1::LogEvent> log;
  const auto next = BeginSnapshot();
  while (auto event = next()) log.push_back(*std::move(event));
  return log;
}

void Scheduler::SnapshotJobs(std::vector<v1::LogEvent>* log) const {
  for (const auto& [number, job] : jobs_) {
    v1::JobSubmitted* submitted = log->emplace_back().mutable_job_submitted();
    submitted->set_job_id(job.id);
    *submitted->mutable_sortie() = job.graph->sortie();
    submitted->set_user(job.user);
    submitted->set_priority(job.priority);
    for (const auto& [place, reason] : job.graph->holes()) {
      v1::TaskQuarantined* quarantined = log->emplace_back().mutable_task_quarantined();
      quarantined->set_job_id(job.id);
      quarantined->set_task_key(tasks_[job.tasks[static_cast<std::size_t>(place.kind) - 1][place.index]].key);
      quarantined->set_status_code(static_cast<std::uint32_t>(reason.code()));
      quarantined->set_message(reason.message());
    }
    if (job.state == v1::JOB_CANCELLED) log->emplace_back().mutable_job_cancelled()->set_job_id(job.id);
    if (job.state == v1::JOB_FAILED) {
      v1::JobFailed* failed = log->emplace_back().mutable_job_failed();
      failed->set_job_id(job.id);
      failed->set_status_code(static_cast<std::uint32_t>(job.error.code()));
      failed->set_message(job.error.message());
    }
  }
  for (const auto& [key, event] : differed_) log->push_back(event);
}

}  // namespace trem
