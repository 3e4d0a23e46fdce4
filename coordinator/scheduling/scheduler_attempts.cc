// The part of Scheduler that knows attempts: their leases, the slots they use, how they end.
#include <algorithm>

#include "coordinator/planning/task_plan.h"
#include "coordinator/scheduling/planted_fault.h"
#include "coordinator/scheduling/scheduler.h"
#include "mosaic/base/check.h"

namespace trem {
namespace {

bool IsOutage(StatusCode code) { return code == StatusCode::kUnavailable || code == StatusCode::kExhausted; }

std::uint64_t Doubled(std::uint32_t delay_ms, std::uint32_t times, std::uint32_t delay_ms_max) {
  return std::min<std::uint64_t>(static_cast<std::uint64_t>(delay_ms) << std::min(times, 20U), delay_ms_max);
}

}  // namespace

// ---- Results ----------------------------------------------------------------------------------------------------------------------

void Scheduler::TakeResult(const TaskDoneEvent& event) {
  const std::string& key = event.attempt.task_key;
  if (const auto worker = workers_.find(event.worker_id); worker != workers_.end()) {
    const auto slot = worker->second.slots.find(key);
    if (slot != worker->second.slots.end() && slot->second.attempt <= event.attempt.number && !TREM_PLANTED(kLeakedSlot)) {
      FreeSlot(event.worker_id, key);
    }
  }
  const TaskIndex index = FindTask(key);
  if (index == kNoTask) return;
  Task& task = tasks_[index];
  if (task.state == TaskState::kFinished) {
    if (event.code == StatusCode::kOk) CompareResults(index, event.attempt.number, *task.finished, event.result);
    return;
  }
  const bool is_leased = FindLease(index, event.attempt.number) != nullptr;
  if (task.state == TaskState::kIdle || (!is_leased && task.newest_attempt != event.attempt.number && !TREM_PLANTED(kNoFence))) return;
  if (event.code != StatusCode::kOk) {
    if (is_leased) OnFailure(index, event);
    return;
  }
  if (const Status status = CheckTaskResult(task.wanted_by.front().place.kind, event.result); !status.ok()) {
    TaskDoneEvent failure = event;
    failure.code = status.code();
    failure.message = status.message();
    if (is_leased) OnFailure(index, failure);
    return;
  }
  if (task.damaged != nullptr) CompareResults(index, event.attempt.number, *task.damaged, event.result);
  v1::LogEvent log;
  v1::TaskCommitted* committed = log.mutable_task_committed();
  committed->set_task_key(key);
  committed->set_kind(task.wanted_by.front().place.kind);
  committed->set_attempt(event.attempt.number);
  *committed->mutable_result() = event.result;
  committed->set_elapsed_ms(event.elapsed_ms);
  committed->set_peak_memory_bytes(event.peak_memory_bytes);
  if (!TREM_PLANTED(kUnloggedResult)) Append(std::move(log));
  Commit(index, task.wanted_by.front().place.kind, {event.result, event.elapsed_ms, event.peak_memory_bytes});
}

bool Scheduler::IsHopeless(const Trouble& trouble) const {
  if (TREM_PLANTED(kNeverGivesUp)) return false;
  if (TREM_PLANTED(kGivesUpAtOnce)) return true;
  if (trouble.outages >= options_.outages_max || trouble.failures >= 2 * options_.failures_max) return true;
  const bool nobody_else = trouble.failed_on.size() >= 2 || workers_.size() < 2;
  return trouble.failures >= options_.failures_max && nobody_else;
}

void Scheduler::OnFailure(TaskIndex index, const TaskDoneEvent& event) {
  if (event.code == StatusCode::kCancelled) {
    return Lose(index, event.attempt.number, true, "worker " + event.worker_id + " gave it back");
  }
  const bool was_last = EndLease(index, event.attempt.number);
  const Task& task = tasks_[index];
  Trouble& trouble = TroubleOf(index);
  const std::string who = TitleOf(task) + " failed on worker " + event.worker_id;
  if (RepairInputs(index, event.bad_artefacts)) {
    effects_.push_back(LogEffect{who + " and waits until its inputs are made again: " + event.message, task.key});
    if (was_last) Delay(index, Doubled(options_.retry_delay_ms, trouble.waits++, options_.retry_delay_ms_max));
    return;
  }
  if (std::find(trouble.failed_on.begin(), trouble.failed_on.end(), event.worker_id) == trouble.failed_on.end()) {
    trouble.failed_on.push_back(event.worker_id);
  }
  ++(IsOutage(event.code) ? trouble.outages : trouble.failures);
  const std::uint32_t times = trouble.failures + trouble.outages;
  const bool is_missing_source = event.code == StatusCode::kNotFound && task.wanted_by.front().place.kind == v1::INGEST;
  if (event.code == StatusCode::kInvalidInput || is_missing_source) return GiveUp(index, Status(event.code, event.message));
  if (!was_last) return;  // The other attempt goes on.
  if (IsHopeless(trouble)) {
    return GiveUp(index, Status(event.code, event.message + " (after " + std::to_string(times) + " attempts)"));
  }
  for (const JobPlace& place : task.wanted_by) jobs_.at(place.job).graph->AddRetry();
  effects_.push_back(LogEffect{who + " and is tried again: " + event.message, task.key});
  const std::uint32_t delay_ms = event.code == StatusCode::kExhausted ? options_.exhausted_delay_ms : options_.retry_delay_ms;
  Delay(index, Doubled(delay_ms, times - 1, std::max(options_.retry_delay_ms_max, delay_ms)));
}

void Scheduler::Lose(TaskIndex index, std::uint32_t attempt, bool counts, const std::string& reason) {
  if (FindLease(index, attempt) == nullptr) return;
  leases_lost_ += counts ? 1 : 0;
  const bool was_last = EndLease(index, attempt);
  const Task& task = tasks_[index];
  const std::uint32_t losses = counts ? ++TroubleOf(index).losses : 0;
  if (!was_last) return;
  if (losses >= options_.losses_max) {
    return GiveUp(index, Unavailable("was handed out " + std::to_string(losses) + " times and never came back; last: " + reason));
  }
  for (const JobPlace& place : task.wanted_by) jobs_.at(place.job).graph->AddRetry();
  effects_.push_back(LogEffect{TitleOf(task) + " goes to another worker: " + reason, task.key});
  if (TREM_PLANTED(kForgottenExpiry) && counts) return;
  Enqueue(index);
}

// ---- Leases -----------------------------------------------------------------------------------------------------------------------

Scheduler::Lease* Scheduler::FindLease(TaskIndex index, std::uint32_t attempt) {
  const auto found = leases_.find(index);
  if (found == leases_.end()) return nullptr;
  for (Lease& lease : found->second) {
    if (lease.attempt == attempt) return &lease;
  }
  return nullptr;
}

void Scheduler::AddLease(TaskIndex index, Lease lease) {
  Task& task = tasks_[index];
  std::vector<Lease>& leases = leases_[index];
  lease.started_ms = now_ms_;
  lease.user = jobs_.at(task.wanted_by.front().job).user;
  ChangeUser(lease.user, [](User& user) {
    ++user.running;
    ++user.served;
  });
  lease_ends_.insert({lease.until_ms, index, lease.attempt});
  if (leases.empty()) {
    task.state = TaskState::kLeased;
    for (const JobPlace& place : task.wanted_by) jobs_.at(place.job).live.emplace(place.place, index);
    alone_.insert({lease.started_ms, index});
  }
  leases.push_back(std::move(lease));
}

void Scheduler::Renew(TaskIndex index, Lease* lease) {
  lease_ends_.erase({lease->until_ms, index, lease->attempt});
  lease->until_ms = now_ms_ + options_.lease_ms;
  lease_ends_.insert({lease->until_ms, index, lease->attempt});
}

void Scheduler::Adopt(TaskIndex index, std::uint32_t attempt, const std::string& worker_id) {
  Task& task = tasks_[index];
  if (Lease* lease = FindLease(index, attempt)) {
    lease->worker_id = worker_id;
    Renew(index, lease);
  } else {
    LeaveQueues(index, "");
    Lease taken_up;
    taken_up.attempt = attempt;
    taken_up.worker_id = worker_id;
    taken_up.until_ms = now_ms_ + options_.lease_ms;
    AddLease(index, taken_up);
  }
  SetSlot(worker_id, task.key, {attempt, true, 0, task.memory_bytes});
}

bool Scheduler::EndLease(TaskIndex index, std::uint32_t attempt) {
  Task& task = tasks_[index];
  std::vector<Lease>& leases = leases_.at(index);
  const auto found = std::find_if(leases.begin(), leases.end(), [&](const Lease& lease) { return lease.attempt == attempt; });
  TREM_CHECK(found != leases.end());
  const Lease lease = *found;
  leases.erase(found);
  lease_ends_.erase({lease.until_ms, index, attempt});
  alone_.erase({lease.started_ms, index});
  ChangeUser(lease.user, [](User& user) { --user.running; });
  if (const auto worker = workers_.find(lease.worker_id); worker != workers_.end()) {
    const auto slot = worker->second.slots.find(task.key);
    if (slot != worker->second.slots.end() && slot->second.live && slot->second.attempt == attempt) {
      SetSlot(lease.worker_id, task.key, {attempt, false, now_ms_ + options_.lease_ms, task.memory_bytes});
    }
  }
  if (!leases.empty()) return false;
  leases_.erase(index);
  for (const JobPlace& place : task.wanted_by) jobs_.at(place.job).live.erase(place.place);
  task.state = TaskState::kIdle;
  return true;
}

void Scheduler::LeaveQueues(TaskIndex index, const std::string& reason) {
  Task& task = tasks_[index];
  switch (task.state) {
    case TaskState::kReady:
      Unqueue(index);
      break;
    case TaskState::kDelayed:
      delayed_.erase({task.until_ms, index});
      break;
    case TaskState::kLeased: {
      const std::vector<Lease> leases = leases_.at(index);
      for (const Lease& lease : leases) {
        const auto worker = workers_.find(lease.worker_id);
        const auto slot = worker == workers_.end() ? std::map<std::string, Slot>::iterator{} : worker->second.slots.find(task.key);
        const bool holds = worker != workers_.end() && slot != worker->second.slots.end() && slot->second.attempt == lease.attempt;
        EndLease(index, lease.attempt);
        if (holds && !TREM_PLANTED(kSilentWinner)) effects_.push_back(CancelTaskEffect{lease.worker_id, {task.key, lease.attempt}, reason});
      }
      break;
    }
    default:
      break;
  }
  task.state = TaskState::kIdle;
}

// ---- Slots ------------------------------------------------------------------------------------------------------------------------

void Scheduler::Revoke(const std::string& worker_id, const Attempt& attempt, const std::string& reason) {
  effects_.push_back(CancelTaskEffect{worker_id, attempt, reason});
  const auto worker = workers_.find(worker_id);
  if (worker == workers_.end()) return;
  const auto slot = worker->second.slots.find(attempt.task_key);
  if (slot != worker->second.slots.end() && slot->second.attempt > attempt.number) return;
  const TaskIndex index = FindTask(attempt.task_key);
  const std::uint64_t memory_bytes = index == kNoTask ? 0 : tasks_[index].memory_bytes;
  SetSlot(worker_id, attempt.task_key, {attempt.number, false, now_ms_ + options_.lease_ms, memory_bytes});
}

void Scheduler::SetSlot(const std::string& worker_id, const std::string& key, const Slot& slot) {
  if (workers_.count(worker_id) == 0) return;
  ChangeWorker(worker_id, [&](Worker& worker) {
    const auto [old, is_new] = worker.slots.try_emplace(key, slot);
    if (is_new) return;
    if (!old->second.live) revoked_.erase({old->second.held_until_ms, worker_id, key});
    old->second = slot;
  });
  if (!slot.live) revoked_.insert({slot.held_until_ms, worker_id, key});
}

void Scheduler::FreeSlot(const std::string& worker_id, const std::string& key) {
  if (workers_.count(worker_id) == 0) return;
  ChangeWorker(worker_id, [&](Worker& worker) {
    const auto slot = worker.slots.find(key);
    if (slot == worker.slots.end()) return;
    if (!slot->second.live) revoked_.erase({slot->second.held_until_ms, worker_id, key});
    worker.slots.erase(slot);
  });
}

}  // namespace trem
