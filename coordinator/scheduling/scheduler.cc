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
  return std::move(effects_);
}

void Scheduler::BeginAfterRestore() {
  restoring_ = false;
  for (const std::string& key : handed_out_before_) {
    const auto task = tasks_.find(key);
    if (task == tasks_.end() || task->second.state != TaskState::kReady) continue;
    Unqueue(key, task->second);
    Lease(key, task->second, "", options_.restart_grace_ms);
  }
  handed_out_before_.clear();
}

// ---- Events of workers and time ---------------------------------------------------------------------------------------------------

void Scheduler::On(const WorkerHelloEvent& event) {
  Worker& worker = workers_[event.worker_id];
  idle_.erase({worker.slots.size(), event.worker_id});
  worker.host = event.host;
  worker.pid = event.pid;
  worker.credit = event.credit;
  worker.memory_bytes_max = event.memory_bytes_max;
  if (worker.slots.size() < worker.credit) idle_.insert({worker.slots.size(), event.worker_id});

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
  const std::map<std::string, Slot> slots = worker.slots;
  for (const auto& [key, slot] : slots) {
    const auto said = running.find(key);
    if (said != running.end() && said->second == slot.attempt) continue;
    const Attempt attempt{key, slot.attempt};
    if (slot.live) {
      effects_.push_back(CancelTaskEffect{event.worker_id, attempt, "the worker did not name it when it came back"});
      // Not held against the task: Hellos that waited while the coordinator was stopped come in a row.
      Lose(key, false, "worker " + event.worker_id + " came back without it");
    }
    FreeSlot(event.worker_id, key);
  }
  for (const auto& [key, number] : running) {
    const auto task = tasks_.find(key);
    const bool newest = newest_attempts_.count(key) > 0 && newest_attempts_.at(key) == number;
    const bool free = task != tasks_.end() && (task->second.state != TaskState::kLeased || task->second.worker_id.empty() ||
                                               task->second.worker_id == event.worker_id);
    if (newest && free) {
      Adopt(key, task->second, event.worker_id);
    } else {
      Revoke(event.worker_id, {key, number}, "the task is finished, not wanted any more, or with another worker");
    }
  }
}

void Scheduler::On(const WorkerLostEvent& event) { TakeBackAll(event.worker_id, true, "worker " + event.worker_id + " stopped answering"); }

void Scheduler::On(const WorkerGoodbyeEvent& event) { TakeBackAll(event.worker_id, false, "worker " + event.worker_id + " left"); }

void Scheduler::TakeBackAll(const std::string& worker_id, bool counts, const std::string& reason) {
  const auto worker = workers_.find(worker_id);
  if (worker == workers_.end()) return;
  const std::map<std::string, Slot> slots = worker->second.slots;
  for (const auto& [key, slot] : slots) {
    FreeSlot(worker_id, key);
    if (slot.live) Lose(key, counts, reason);
  }
  idle_.erase({0, worker_id});
  workers_.erase(worker_id);
}

void Scheduler::On(const ProgressEvent& event) {
  const auto worker = workers_.find(event.worker_id);
  if (worker == workers_.end()) return;
  const std::string& key = event.attempt.task_key;
  const auto task = tasks_.find(key);
  const bool newest = task != tasks_.end() && newest_attempts_[key] == event.attempt.number;
  if (newest && task->second.state == TaskState::kLeased) {
    if (task->second.worker_id.empty()) Adopt(key, task->second, event.worker_id);
    if (task->second.worker_id == event.worker_id) {
      task->second.fraction = std::clamp(event.fraction, 0.0, 1.0);
      Renew(key, task->second);
      return;
    }
  }
  Revoke(event.worker_id, event.attempt, "the attempt is no longer the task's current one");
}

void Scheduler::On(const TaskDoneEvent& event) {
  TakeResult(event);
  effects_.push_back(AckEffect{event.worker_id, event.attempt});  // Behind what TakeResult has to make durable.
}

void Scheduler::TakeResult(const TaskDoneEvent& event) {
  const std::string& key = event.attempt.task_key;
  if (const auto worker = workers_.find(event.worker_id); worker != workers_.end()) {
    const auto slot = worker->second.slots.find(key);
    if (slot != worker->second.slots.end() && slot->second.attempt <= event.attempt.number) FreeSlot(event.worker_id, key);
  }
  if (finished_.count(key) > 0) {
    if (event.code == StatusCode::kOk) CompareWithCommitted(event.attempt, event.result);
    return;
  }
  const auto found = tasks_.find(key);
  if (found == tasks_.end() || newest_attempts_[key] != event.attempt.number) return;
  Task& task = found->second;
  if (event.code != StatusCode::kOk) {
    if (task.state == TaskState::kLeased) OnFailure(key, task, event);
    return;
  }
  const TaskPlace place = task.wanted_by.begin()->second;
  if (const Status status = CheckTaskResult(place.kind, event.result); !status.ok()) {
    LeaveQueues(key, task);
    Enqueue(key, task);
    FailJobsOf(key, status.code(), status.message());
    return;
  }
  v1::LogEvent log;
  v1::TaskCommitted* committed = log.mutable_task_committed();
  committed->set_task_key(key);
  committed->set_kind(place.kind);
  committed->set_attempt(event.attempt.number);
  *committed->mutable_result() = event.result;
  committed->set_elapsed_ms(event.elapsed_ms);
  committed->set_peak_memory_bytes(event.peak_memory_bytes);
  Append(std::move(log));
  Commit(key, {event.result, event.elapsed_ms, event.peak_memory_bytes});
}

void Scheduler::OnFailure(const std::string& key, Task& task, const TaskDoneEvent& event) {
  if (event.code == StatusCode::kCancelled) return Lose(key, true, "worker " + event.worker_id + " gave it back");
  LeaveQueues(key, task);
  Enqueue(key, task);
  switch (event.code) {
    case StatusCode::kUnavailable:
    case StatusCode::kExhausted:
    case StatusCode::kCorrupt: {
      ++task.failures;
      if (task.failures >= options_.failures_max) {
        FailJobsOf(key, event.code, event.message + " (after " + std::to_string(task.failures) + " attempts)");
        return;
      }
      for (const JobPlace& place : task.wanted_by) jobs_.at(place.first).graph->AddRetry();
      effects_.push_back(LogEffect{TitleOf(task) + " failed on worker " + event.worker_id + " and is tried again: " + event.message});
      LeaveQueues(key, task);
      Delay(key, task);
      return;
    }
    default:
      FailJobsOf(key, event.code, event.message);
  }
}

void Scheduler::On(const TickEvent&) {
  while (!leases_.empty() && leases_.begin()->first <= now_ms_) {
    const std::string key = leases_.begin()->second;
    const std::string worker_id = tasks_.at(key).worker_id;
    if (!worker_id.empty()) {
      Revoke(worker_id, {key, newest_attempts_.at(key)}, "no progress for " + std::to_string(options_.lease_ms) + " ms");
    }
    Lose(key, !worker_id.empty(),
         worker_id.empty() ? "its worker did not come back after the restart" : "worker " + worker_id + " made no progress");
  }
  while (!delayed_.empty() && delayed_.begin()->first <= now_ms_) {
    const std::string key = delayed_.begin()->second;
    Task& task = tasks_.at(key);
    LeaveQueues(key, task);
    Enqueue(key, task);
  }
  while (!revoked_.empty() && std::get<0>(*revoked_.begin()) <= now_ms_) {
    const auto [end_ms, worker_id, key] = *revoked_.begin();
    FreeSlot(worker_id, key);
  }
}

// ---- Leases and slots -------------------------------------------------------------------------------------------------------------

void Scheduler::Lose(const std::string& key, bool counts, const std::string& reason) {
  const auto found = tasks_.find(key);
  if (found == tasks_.end() || found->second.state != TaskState::kLeased) return;
  Task& task = found->second;
  LeaveQueues(key, task);
  Enqueue(key, task);
  if (counts) ++task.losses;
  if (task.losses >= options_.losses_max) {
    FailJobsOf(key, StatusCode::kUnavailable,
               "was handed out " + std::to_string(task.losses) + " times and never came back; last: " + reason);
    return;
  }
  for (const JobPlace& place : task.wanted_by) jobs_.at(place.first).graph->AddRetry();
  effects_.push_back(LogEffect{TitleOf(task) + " goes to another worker: " + reason});
}

void Scheduler::Revoke(const std::string& worker_id, const Attempt& attempt, const std::string& reason) {
  effects_.push_back(CancelTaskEffect{worker_id, attempt, reason});
  if (const auto worker = workers_.find(worker_id); worker != workers_.end()) {
    const auto slot = worker->second.slots.find(attempt.task_key);
    const bool has_newer = slot != worker->second.slots.end() && slot->second.attempt > attempt.number;
    if (!has_newer) SetSlot(worker_id, attempt.task_key, {attempt.number, false, now_ms_ + options_.lease_ms});
  }
}

void Scheduler::Enqueue(const std::string& key, Task& task) {
  task.state = TaskState::kReady;
  task.worker_id.clear();
  task.fraction = 0.0;
  ready_[task.memory_bytes].insert({*task.wanted_by.begin(), key});
}

void Scheduler::Unqueue(const std::string& key, const Task& task) {
  const auto queue = ready_.find(task.memory_bytes);
  TREM_CHECK(queue != ready_.end() && queue->second.erase({*task.wanted_by.begin(), key}) == 1);
  if (queue->second.empty()) ready_.erase(queue);
}

void Scheduler::Delay(const std::string& key, Task& task) {
  task.state = TaskState::kDelayed;
  task.worker_id.clear();
  task.fraction = 0.0;
  task.until_ms = now_ms_ + (static_cast<TimeMs>(options_.retry_delay_ms) << std::min(task.failures - 1, 10U));
  delayed_.insert({task.until_ms, key});
}

void Scheduler::Lease(const std::string& key, Task& task, const std::string& worker_id, std::uint32_t lease_ms) {
  task.state = TaskState::kLeased;
  task.worker_id = worker_id;
  task.until_ms = now_ms_ + lease_ms;
  leases_.insert({task.until_ms, key});
}

void Scheduler::Renew(const std::string& key, Task& task) {
  leases_.erase({task.until_ms, key});
  task.until_ms = now_ms_ + options_.lease_ms;
  leases_.insert({task.until_ms, key});
}

void Scheduler::Adopt(const std::string& key, Task& task, const std::string& worker_id) {
  LeaveQueues(key, task);
  Lease(key, task, worker_id, options_.lease_ms);
  SetSlot(worker_id, key, {newest_attempts_.at(key), true, 0});
}

// Takes the task out of whichever queue its state has it in.
void Scheduler::LeaveQueues(const std::string& key, Task& task) {
  switch (task.state) {
    case TaskState::kReady:
      Unqueue(key, task);
      break;
    case TaskState::kDelayed:
      delayed_.erase({task.until_ms, key});
      break;
    case TaskState::kLeased:
      leases_.erase({task.until_ms, key});
      if (const auto worker = workers_.find(task.worker_id); worker != workers_.end()) {
        // The lease ends; the slot stays until the worker has said that it is done with it, or is freed by whoever called.
        const auto slot = worker->second.slots.find(key);
        if (slot != worker->second.slots.end() && slot->second.live) {
          SetSlot(task.worker_id, key, {slot->second.attempt, false, now_ms_ + options_.lease_ms});
        }
      }
      break;
  }
}

void Scheduler::SetSlot(const std::string& worker_id, const std::string& key, const Slot& slot) {
  const auto found = workers_.find(worker_id);
  if (found == workers_.end()) return;
  Worker& worker = found->second;
  idle_.erase({worker.slots.size(), worker_id});
  const auto [old, is_new] = worker.slots.try_emplace(key, slot);
  if (!is_new) {
    if (!old->second.live) revoked_.erase({old->second.held_until_ms, worker_id, key});
    old->second = slot;
  }
  if (!slot.live) revoked_.insert({slot.held_until_ms, worker_id, key});
  if (worker.slots.size() < worker.credit) idle_.insert({worker.slots.size(), worker_id});
}

void Scheduler::FreeSlot(const std::string& worker_id, const std::string& key) {
  const auto found = workers_.find(worker_id);
  if (found == workers_.end()) return;
  Worker& worker = found->second;
  const auto slot = worker.slots.find(key);
  if (slot == worker.slots.end()) return;
  idle_.erase({worker.slots.size(), worker_id});
  if (!slot->second.live) revoked_.erase({slot->second.held_until_ms, worker_id, key});
  worker.slots.erase(slot);
  if (worker.slots.size() < worker.credit) idle_.insert({worker.slots.size(), worker_id});
}

// ---- Dispatch ---------------------------------------------------------------------------------------------------------------------

const std::string* Scheduler::BestReadyFor(const Worker& worker) const {
  const std::pair<JobPlace, std::string>* best = nullptr;
  for (const auto& [memory_bytes, queue] : ready_) {
    if (worker.memory_bytes_max != 0 && memory_bytes > worker.memory_bytes_max) break;
    if (best == nullptr || *queue.begin() < *best) best = &*queue.begin();
  }
  return best == nullptr ? nullptr : &best->second;
}

void Scheduler::DispatchReady() {
  auto worker = idle_.begin();
  while (worker != idle_.end() && !ready_.empty()) {
    const std::string worker_id = worker->second;
    const std::string* key = BestReadyFor(workers_.at(worker_id));
    if (key == nullptr) {
      ++worker;
      continue;
    }
    const std::pair<std::size_t, std::string> position = *worker;
    DispatchTo(worker_id, std::string(*key));
    worker = idle_.lower_bound(position);
  }
}

void Scheduler::DispatchTo(const std::string& worker_id, const std::string& key) {
  Task& task = tasks_.at(key);
  Unqueue(key, task);
  const std::uint32_t number = ++newest_attempts_[key];
  v1::LogEvent log;
  log.mutable_attempt_started()->set_task_key(key);
  log.mutable_attempt_started()->set_attempt(number);
  log.mutable_attempt_started()->set_worker_id(worker_id);
  Append(std::move(log));
  Lease(key, task, worker_id, options_.lease_ms);
  SetSlot(worker_id, key, {number, true, 0});
  const auto& [job_number, place] = *task.wanted_by.begin();
  effects_.push_back(DispatchEffect{worker_id, jobs_.at(job_number).graph->Spec(place), number, options_.lease_ms});
}

}  // namespace trem
