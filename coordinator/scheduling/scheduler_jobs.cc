// The part of Scheduler that knows jobs: how they start, unfold, share tasks and end.
#include <algorithm>

#include "coordinator/planning/task_plan.h"
#include "coordinator/scheduling/planted_fault.h"
#include "coordinator/scheduling/scheduler.h"
#include "mosaic/base/check.h"

namespace trem {
namespace {

// Artefacts by name and digest, for comparing two results of one key.
bool SameOutputs(const v1::TaskResult& a, const v1::TaskResult& b) {
  return std::equal(a.outputs().begin(), a.outputs().end(), b.outputs().begin(), b.outputs().end(),
                    [](const v1::ArtefactRef& x, const v1::ArtefactRef& y) { return x.name() == y.name() && x.sha256() == y.sha256(); });
}

bool HasOutputAmong(const v1::TaskResult& result, const std::vector<std::string>& digests) {
  return std::any_of(result.outputs().begin(), result.outputs().end(), [&](const v1::ArtefactRef& output) {
    return std::find(digests.begin(), digests.end(), output.sha256()) != digests.end();
  });
}

}  // namespace

// ---- Beginning --------------------------------------------------------------------------------------------------------------------

void Scheduler::On(const SubmitJobEvent& event) {
  const auto number = job_numbers_.find(event.job_id);
  if (number != job_numbers_.end()) {
    const v1::JobState state = jobs_.at(number->second).state;
    if (state != v1::JOB_FAILED && state != v1::JOB_CANCELLED) return;
  }
  AppendSubmitted(event.job_id, event.sortie, event.user, event.priority);
}

void Scheduler::On(const RetryJobEvent& event) {
  const auto number = job_numbers_.find(event.job_id);
  if (number == job_numbers_.end()) return;
  const Job& job = jobs_.at(number->second);
  if (job.state == v1::JOB_RUNNING || job.state == v1::JOB_DONE) return;
  AppendSubmitted(job.id, v1::Sortie(job.graph->sortie()), std::string(job.user), job.priority);
}

void Scheduler::AppendSubmitted(const std::string& job_id, const v1::Sortie& sortie, const std::string& user, int priority) {
  v1::LogEvent log;
  v1::JobSubmitted* submitted = log.mutable_job_submitted();
  submitted->set_job_id(job_id);
  *submitted->mutable_sortie() = sortie;
  submitted->set_user(user);
  submitted->set_priority(priority);
  const v1::JobSubmitted copy = *submitted;
  Append(std::move(log));
  StartJob(copy);
}

void Scheduler::StartJob(const v1::JobSubmitted& submitted) {
  const auto [known, is_new] = job_numbers_.try_emplace(submitted.job_id(), next_job_number_);
  next_job_number_ += is_new ? 1 : 0;
  const JobNumber number = known->second;
  Job& job = jobs_[number];
  job = Job();
  job.id = submitted.job_id();
  job.user = submitted.user();
  job.priority = submitted.priority();
  job.graph = std::make_unique<JobGraph>(job.id, submitted.sortie());
  effects_.push_back(JobChangedEffect{job.id});
  Completions completions;
  Want(number, job.graph->Start(), &completions);
  Deliver(std::move(completions));
}

void Scheduler::Want(JobNumber number, const PlannedTask& planned, Completions* finished_already) {
  Job& job = jobs_.at(number);
  const JobPlace place{number, planned.place};
  const TaskIndex index = FindOrAddTask(planned.key);
  Task& task = tasks_[index];
  std::vector<TaskIndex>& stage = job.tasks[static_cast<std::size_t>(planned.place.kind) - 1];
  if (stage.size() <= planned.place.index) stage.resize(planned.place.index + 1, kNoTask);
  stage[planned.place.index] = index;
  task.memory_bytes = planned.memory_bytes;  // Of a finished task too: its result may turn out to be damaged.
  if (task.wanted_by.empty()) task.locality = planned.locality;
  if (task.state == TaskState::kFinished) {
    finished_already->push_back({place, index});
    return;
  }
  ++job.memory_wanted[planned.memory_bytes];
  if (task.wanted_by.empty()) {
    task.trouble.reset();
    task.repairs = 0;
    task.wanted_by.push_back(place);
    Enqueue(index);
    return;
  }
  // The place of the most urgent job that wants it is its place in the queue.
  const bool is_ready = task.state == TaskState::kReady;
  if (is_ready) Unqueue(index);
  const auto behind = std::find_if(task.wanted_by.begin(), task.wanted_by.end(),
                                   [&](const JobPlace& other) { return jobs_.at(other.job).priority < job.priority; });
  task.wanted_by.insert(behind, place);
  if (is_ready) Enqueue(index);
  if (task.state == TaskState::kLeased) job.live.emplace(place.place, index);
}

// ---- Results ----------------------------------------------------------------------------------------------------------------------

void Scheduler::Commit(TaskIndex index, v1::TaskKind kind, FinishedTask finished) {
  Task& task = tasks_[index];
  LeaveQueues(index, "another attempt was faster");
  task.state = TaskState::kFinished;
  task.was_handed_out = false;
  task.finished = std::make_unique<Finished>(Finished{kind, std::make_shared<const FinishedTask>(std::move(finished)), {}});
  if (task.damaged != nullptr) {
    // Jobs that are done had the damaged one and have this one now; those that want it are told below.
    task.finished->used_by = std::move(task.damaged->used_by);
    std::erase_if(task.finished->used_by, [&](const JobPlace& place) { return std::ranges::count(task.wanted_by, place) > 0; });
    task.damaged.reset();
  }
  task.trouble.reset();
  Completions completions;
  for (const JobPlace& place : task.wanted_by) {
    completions.push_back({place, index});
    auto& memory_wanted = jobs_.at(place.job).memory_wanted;
    if (--memory_wanted.at(task.memory_bytes) == 0) memory_wanted.erase(task.memory_bytes);
  }
  task.wanted_by = {};
  Deliver(std::move(completions));
}

// Tells jobs of results. What they unfold may be finished already (another job's, or from before a restart), hence the loop.
void Scheduler::Deliver(Completions completions) {
  for (std::size_t i = 0; i < completions.size(); ++i) {
    const auto [place, index] = completions[i];
    Job& job = jobs_.at(place.job);
    if (job.state != v1::JOB_RUNNING) continue;
    Finished& finished = *tasks_[index].finished;
    finished.used_by.push_back(place);
    Unfold(place.job, job.graph->Finish(place.place, *finished.task), &completions);
  }
}

// Takes in what has become known of a job, or that it cannot go on.
void Scheduler::Unfold(JobNumber number, Result<std::vector<PlannedTask>> planned, Completions* completions) {
  if (!planned.ok()) return FailJob(number, planned.status());
  for (const PlannedTask& task : *planned) Want(number, task, completions);
  const JobGraph& graph = *jobs_.at(number).graph;
  if (graph.done()) EndJob(number, graph.in_part() ? v1::JOB_DONE_IN_PART : v1::JOB_DONE, {});
}

void Scheduler::CompareResults(TaskIndex index, std::uint32_t attempt, const Finished& kept, const v1::TaskResult& result) {
  if (SameOutputs(kept.task->result, result)) return;
  const std::string& key = tasks_[index].key;
  v1::LogEvent log;
  log.mutable_result_differed()->set_task_key(key);
  log.mutable_result_differed()->set_attempt(attempt);
  v1::Note* note = log.mutable_result_differed()->mutable_note();
  note->set_code("result_differs");
  note->set_subject(key);
  note->set_message("attempt " + std::to_string(attempt) + " of this task gave other bytes than the " +
                    (tasks_[index].damaged == nullptr ? "committed result, which is kept" : "result that was made before it") +
                    "; a worker's memory, disk or program may be faulty");
  note->set_severity(v1::WARNING);
  for (const JobPlace& place : kept.used_by) {
    jobs_.at(place.job).graph->AddNote(*note);
    effects_.push_back(JobChangedEffect{jobs_.at(place.job).id});
  }
  effects_.push_back(LogEffect{"task " + key + ": " + note->message(), key});
  differed_.insert_or_assign(key, log);
  Append(std::move(log));
}

// ---- Damage -----------------------------------------------------------------------------------------------------------------------

// Has whoever made these artefacts make them again. False: nobody is known who could.
bool Scheduler::RepairInputs(TaskIndex index, const std::vector<std::string>& bad_artefacts) {
  if (bad_artefacts.empty()) return false;
  bool is_repaired = false;
  const std::vector<JobPlace> wanted_by = tasks_[index].wanted_by;
  for (const JobPlace& place : wanted_by) {
    for (const std::vector<TaskIndex>& stage : jobs_.at(place.job).tasks) {
      for (const TaskIndex maker : stage) {
        if (maker == kNoTask || maker == index) continue;
        const Task& task = tasks_[maker];
        if (task.damaged != nullptr && HasOutputAmong(task.damaged->task->result, bad_artefacts)) is_repaired = true;
        if (task.finished == nullptr || !HasOutputAmong(task.finished->task->result, bad_artefacts)) continue;
        if (task.repairs >= options_.repairs_max) continue;
        v1::LogEvent log;
        log.mutable_task_invalidated()->set_task_key(task.key);
        log.mutable_task_invalidated()->set_message("its artefacts are damaged or missing");
        Append(std::move(log));
        Invalidate(maker);
        effects_.push_back(LogEffect{"task " + task.key + " is done again: its artefacts are damaged or missing", task.key});
        is_repaired = true;
      }
    }
  }
  return is_repaired;
}

void Scheduler::Invalidate(TaskIndex index) {
  Task& task = tasks_[index];
  task.damaged = std::move(task.finished);
  task.state = TaskState::kIdle;
  ++task.repairs;
  for (const JobPlace& place : task.damaged->used_by) {
    Job& job = jobs_.at(place.job);
    const auto& stage = job.tasks[static_cast<std::size_t>(place.place.kind) - 1];
    const bool is_current = place.place.index < stage.size() && stage[place.place.index] == index;
    if (job.state != v1::JOB_RUNNING || !is_current || job.graph->IsPending(place.place)) continue;
    job.graph->Reopen(place.place, *task.damaged->task);
    ++job.memory_wanted[task.memory_bytes];
    const auto behind = std::find_if(task.wanted_by.begin(), task.wanted_by.end(),
                                     [&](const JobPlace& other) { return jobs_.at(other.job).priority < job.priority; });
    task.wanted_by.insert(behind, place);
  }
  if (task.wanted_by.empty()) {
    task.damaged.reset();
  } else if (!TREM_PLANTED(kForgottenRepair)) {
    Enqueue(index);
  }
}

// ---- Ends -------------------------------------------------------------------------------------------------------------------------

void Scheduler::StopWanting(TaskIndex index, const JobPlace& place) {
  Task& task = tasks_[index];
  const bool is_ready = task.state == TaskState::kReady;
  if (is_ready) Unqueue(index);
  Job& job = jobs_.at(place.job);
  TREM_CHECK(std::erase(task.wanted_by, place) == 1);
  job.live.erase(place.place);
  if (--job.memory_wanted.at(task.memory_bytes) == 0) job.memory_wanted.erase(task.memory_bytes);
  if (!task.wanted_by.empty()) {
    if (is_ready) Enqueue(index);
    return;
  }
  LeaveQueues(index, "job " + job.id + " does not want it any more");
  if (task.damaged == nullptr) return;
  // Nobody waits for it to be made again: what it was is known, and a job that ended without it still has it. Who reads it will find the
  // damage again.
  task.finished = std::move(task.damaged);
  task.state = TaskState::kFinished;
}

void Scheduler::On(const CancelJobEvent& event) {
  const auto number = job_numbers_.find(event.job_id);
  if (number == job_numbers_.end() || jobs_.at(number->second).state != v1::JOB_RUNNING) return;
  v1::LogEvent log;
  log.mutable_job_cancelled()->set_job_id(event.job_id);
  Append(std::move(log));
  EndJob(number->second, v1::JOB_CANCELLED, {});
}

void Scheduler::On(const RemoveJobEvent& event) {
  const auto number = job_numbers_.find(event.job_id);
  if (number == job_numbers_.end() || jobs_.at(number->second).state == v1::JOB_RUNNING) return;
  v1::LogEvent log;
  log.mutable_job_removed()->set_job_id(event.job_id);
  if (!TREM_PLANTED(kUnloggedRemoval)) Append(std::move(log));
  ForgetJob(number->second);
}

// Every result is looked at: those that an earlier shape of the job has used are not among its tasks any more.
void Scheduler::ForgetJob(JobNumber number) {
  const auto let_go = [number](std::unique_ptr<Finished>* finished) {
    if (*finished == nullptr) return;
    std::erase_if((*finished)->used_by, [number](const JobPlace& place) { return place.job == number; });
  };
  for (Task& task : tasks_) {
    let_go(&task.damaged);
    let_go(&task.finished);
    if (task.finished == nullptr || (!task.finished->used_by.empty() && !TREM_PLANTED(kForgetsOthersResults))) continue;
    task.finished.reset();
    task.state = TaskState::kIdle;  // Its number stays: it fences whoever may still be at it.
    differed_.erase(task.key);
  }
  job_numbers_.erase(jobs_.at(number).id);
  jobs_.erase(number);
}

// Ends a running job and lets go of its tasks; those that no other job wants are taken back.
void Scheduler::EndJob(JobNumber number, v1::JobState state, const Status& error) {
  Job& job = jobs_.at(number);
  if (job.state != v1::JOB_RUNNING) return;
  job.state = state;
  job.error = error;
  effects_.push_back(JobChangedEffect{job.id});
  for (std::size_t kind = 0; kind < job.tasks.size(); ++kind) {
    for (std::uint32_t i = 0; i < job.tasks[kind].size(); ++i) {
      const TaskPlace place{static_cast<v1::TaskKind>(kind + 1), i};
      const TaskIndex index = job.tasks[kind][i];
      if (index != kNoTask && job.graph->IsPending(place) && tasks_[index].state != TaskState::kFinished) {
        StopWanting(index, {number, place});
      }
    }
  }
  groups_.erase(groups_.lower_bound({number, 0, 0}), groups_.lower_bound({number + 1, 0, 0}));
}

void Scheduler::FailJob(JobNumber number, const Status& error) {
  v1::LogEvent log;
  log.mutable_job_failed()->set_job_id(jobs_.at(number).id);
  log.mutable_job_failed()->set_status_code(static_cast<std::uint32_t>(error.code()));
  log.mutable_job_failed()->set_message(error.message());
  Append(std::move(log));
  EndJob(number, v1::JOB_FAILED, error);
}

// A task that will not be tried again: a hole of its jobs, or their end.
void Scheduler::GiveUp(TaskIndex index, const Status& reason) {
  const std::vector<JobPlace> wanted_by = tasks_[index].wanted_by;
  for (const auto& [number, place] : wanted_by) {
    if (jobs_.at(number).state != v1::JOB_RUNNING) continue;
    if (place.kind == v1::ENHANCE || place.kind == v1::COMPOSITE) {
      effects_.push_back(LogEffect{TaskTitle(place.kind, place.index) + " of job " + jobs_.at(number).id +
                                       " is given up; the job goes on without it: " + reason.message(),
                                   tasks_[index].key});
      v1::LogEvent log;
      log.mutable_task_quarantined()->set_job_id(jobs_.at(number).id);
      log.mutable_task_quarantined()->set_task_key(tasks_[index].key);
      log.mutable_task_quarantined()->set_status_code(static_cast<std::uint32_t>(reason.code()));
      log.mutable_task_quarantined()->set_message(reason.message());
      Append(std::move(log));
      MakeHole(number, place, reason);
      continue;
    }
    // What INGEST and EXPORT report is about the user's files and stands for itself.
    const bool says_itself = place.kind != v1::ALIGN && reason.code() != StatusCode::kUnavailable;
    FailJob(number, says_itself ? reason : reason.WithPrefix(TaskTitle(place.kind, place.index)));
  }
}

void Scheduler::MakeHole(JobNumber number, const TaskPlace& place, const Status& reason) {
  Job& job = jobs_.at(number);
  StopWanting(job.tasks[static_cast<std::size_t>(place.kind) - 1][place.index], {number, place});
  Completions completions;
  Unfold(number, job.graph->GiveUp(place, reason), &completions);
  Deliver(std::move(completions));
}

}  // namespace trem
