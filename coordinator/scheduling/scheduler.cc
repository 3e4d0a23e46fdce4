// The half of Scheduler that takes in what workers and time do.
#include "coordinator/scheduling/scheduler.h"

#include <algorithm>

#include "mosaic/base/check.h"

namespace trem {

std::vector<Effect> Scheduler::Step(TimeMs now_ms, const Event& event) {
  TREM_CHECK_MSG(now_ms >= now_ms_, "time went back from " + std::to_string(now_ms_) + " to " + std::to_string(now_ms) + " ms");
  now_ms_ = now_ms;
  if (restoring_) BeginAfterRestore();
  effects_.clear();
  std::visit([this](const auto& e) { On(e); }, event);
  DispatchReady();
  if (std::holds_alternative<TickEvent>(event)) HedgeStragglers();
  ShareProcessors();
  return std::move(effects_);
}

void Scheduler::BeginAfterRestore() {
  restoring_ = false;
  for (TaskIndex index = 0; index < tasks_.size(); ++index) {
    Task& task = tasks_[index];
    if (!std::exchange(task.was_handed_out, false) || task.state != TaskState::kReady) continue;
    Unqueue(index);
    Lease lease;
    lease.attempt = task.newest_attempt;
    lease.until_ms = now_ms_ + options_.restart_grace_ms;
    AddLease(index, lease);
  }
}

TaskIndex Scheduler::FindTask(const std::string& key) const {
  const auto found = task_indices_.find(key);
  return found == task_indices_.end() ? kNoTask : found->second;
}

TaskIndex Scheduler::FindOrAddTask(const std::string& key) {
  if (const TaskIndex known = FindTask(key); known != kNoTask) return known;
  const auto index = static_cast<TaskIndex>(tasks_.size());
  TREM_CHECK(index != kNoTask);
  tasks_.emplace_back().key = key;
  task_indices_.emplace(tasks_.back().key, index);
  return index;
}

Scheduler::Trouble& Scheduler::TroubleOf(TaskIndex index) {
  std::unique_ptr<Trouble>& trouble = tasks_[index].trouble;
  if (trouble == nullptr) trouble = std::make_unique<Trouble>();
  return *trouble;
}

// ---- Events of workers ------------------------------------------------------------------------------------------------------------

void Scheduler::On(const WorkerHelloEvent& event) {
  const bool is_new = workers_.count(event.worker_id) == 0;
  if (!is_new) {
    const Worker& known = workers_.at(event.worker_id);
    memory_limits_.erase(memory_limits_.find(MemoryLimit(known.memory_bytes_max)));
    --hosts_.at(known.host).worker_count;
  }
  workers_.try_emplace(event.worker_id);
  ChangeWorker(event.worker_id, [&](Worker& worker) {
    worker.host = event.host;
    worker.pid = event.pid;
    worker.credit = event.credit;
    worker.memory_bytes_max = event.memory_bytes_max;
    for (auto& [key, slot] : worker.slots) slot.processors = 1;  // It has forgotten what it was told.
  });
  memory_limits_.insert(MemoryLimit(event.memory_bytes_max));
  ++hosts_[event.host].worker_count;

  // What it has is what it says: a Dispatch that it never got must not keep a lease alive.
  std::map<std::string, std::uint32_t> running;
  for (const Attempt& attempt : event.running) {
    std::uint32_t& number = running[attempt.task_key];
    if (number != 0) {
      const std::uint32_t older = std::min(number, attempt.number);
      effects_.push_back(CancelTaskEffect{event.worker_id, {attempt.task_key, older}, "the worker has a newer attempt of the same task"});
    }
    number = std::max(number, attempt.number);
  }
  const std::map<std::string, Slot> slots = workers_.at(event.worker_id).slots;
  for (const auto& [key, slot] : slots) {
    const auto said = running.find(key);
    if (said != running.end() && said->second == slot.attempt) continue;
    if (slot.live) {
      effects_.push_back(CancelTaskEffect{event.worker_id, {key, slot.attempt}, "the worker did not name it when it came back"});
      // Not held against the task: Hellos that waited while the coordinator was stopped come in a row.
      Lose(FindTask(key), slot.attempt, false, "worker " + event.worker_id + " came back without it");
    }
    FreeSlot(event.worker_id, key);
  }
  for (const auto& [key, number] : running) {
    const TaskIndex index = FindTask(key);
    const Lease* lease = FindLease(index, number);
    const bool is_its_own = lease != nullptr && (lease->worker_id.empty() || lease->worker_id == event.worker_id);
    const bool is_free = index != kNoTask && (tasks_[index].newest_attempt == number || TREM_PLANTED(kAdoptsOldAttempts)) &&
                         (tasks_[index].state == TaskState::kReady || tasks_[index].state == TaskState::kDelayed);
    if (is_its_own || is_free) {
      Adopt(index, number, event.worker_id);
    } else {
      Revoke(event.worker_id, {key, number}, "the task is finished, not wanted any more, or with another worker");
    }
  }
}

void Scheduler::On(const WorkerLostEvent& event) { TakeBackAll(event.worker_id, true, "worker " + event.worker_id + " stopped answering"); }

void Scheduler::On(const WorkerGoodbyeEvent& event) { TakeBackAll(event.worker_id, false, "worker " + event.worker_id + " left"); }

void Scheduler::On(const DrainWorkerEvent& event) {
  if (workers_.count(event.worker_id) == 0) return;
  ChangeWorker(event.worker_id, [](Worker& worker) { worker.is_draining = !TREM_PLANTED(kServesDraining); });
  effects_.push_back(DrainWorkerEffect{event.worker_id});
}

void Scheduler::TakeBackAll(const std::string& worker_id, bool counts, const std::string& reason) {
  const auto worker = workers_.find(worker_id);
  if (worker == workers_.end()) return;
  const std::map<std::string, Slot> slots = worker->second.slots;
  for (const auto& [key, slot] : slots) {
    FreeSlot(worker_id, key);
    if (slot.live) Lose(FindTask(key), slot.attempt, counts, reason);
  }
  // Out of the idle ones by asking for nothing more.
  ChangeWorker(worker_id, [](Worker& leaving) { leaving.is_draining = true; });
  memory_limits_.erase(memory_limits_.find(MemoryLimit(worker->second.memory_bytes_max)));
  const auto host = hosts_.find(worker->second.host);
  if (--host->second.worker_count == 0) hosts_.erase(host);
  workers_.erase(worker);
}

void Scheduler::On(const ProgressEvent& event) {
  if (workers_.count(event.worker_id) == 0) return;
  const TaskIndex index = FindTask(event.attempt.task_key);
  if (Lease* lease = FindLease(index, event.attempt.number)) {
    if (lease->worker_id.empty()) Adopt(index, event.attempt.number, event.worker_id);
    if (lease->worker_id == event.worker_id) {
      // Parts of a task that run side by side tell how far each of them is; what is done stays done.
      lease->fraction = std::max(lease->fraction, std::clamp(event.fraction, 0.0, 1.0));
      Renew(index, lease);
      return;
    }
  }
  Revoke(event.worker_id, event.attempt, "the attempt is no longer the task's current one");
}

void Scheduler::On(const TaskDoneEvent& event) {
  if (TREM_PLANTED(kAckBeforeLog)) effects_.push_back(AckEffect{event.worker_id, event.attempt});
  TakeResult(event);
  effects_.push_back(AckEffect{event.worker_id, event.attempt});  // Behind what TakeResult has to make durable.
}

void Scheduler::On(const TickEvent&) {
  while (!lease_ends_.empty() && !TREM_PLANTED(kEndlessLease) && std::get<0>(*lease_ends_.begin()) <= now_ms_) {
    const auto [end_ms, index, attempt] = *lease_ends_.begin();
    const std::string worker_id = FindLease(index, attempt)->worker_id;
    if (!worker_id.empty()) {
      Revoke(worker_id, {tasks_[index].key, attempt}, "no progress for " + std::to_string(options_.lease_ms) + " ms");
    }
    Lose(index, attempt, !worker_id.empty(),
         worker_id.empty() ? "its worker did not come back after the restart" : "worker " + worker_id + " made no progress");
  }
  while (!delayed_.empty() && delayed_.begin()->first <= now_ms_) {
    const TaskIndex index = delayed_.begin()->second;
    delayed_.erase(delayed_.begin());
    Enqueue(index);
  }
  while (!revoked_.empty() && std::get<0>(*revoked_.begin()) <= now_ms_) {
    const auto [end_ms, worker_id, key] = *revoked_.begin();
    FreeSlot(worker_id, key);
  }
}

}  // namespace trem
