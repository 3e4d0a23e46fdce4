// The part of Scheduler that decides which task goes where: queues, fair share, placement, hedges.
#include <algorithm>
#include <limits>
#include <utility>

#include "coordinator/scheduling/planted_fault.h"
#include "coordinator/scheduling/scheduler.h"
#include "mosaic/base/check.h"

namespace trem {
namespace {

// How many groups of tasks that other hosts work on are looked past for one that nobody does.
constexpr int kGroupsLookedAt = 8;
// How many of the longest running tasks are looked at for stragglers at once, and idle workers for one on another host.
constexpr int kStragglersLookedAt = 64;
constexpr int kIdleLookedAt = 8;
// How often a task that failed waits for a worker on which it has not.
constexpr std::uint32_t kWaitsMax = 5;
// Of a host with more running tasks than this, none is lent a processor: it would be told to all of them again and again.
constexpr std::uint32_t kSharersMax = 64;

bool Contains(const std::vector<std::string>& list, const std::string& text) {
  return std::find(list.begin(), list.end(), text) != list.end();
}

}  // namespace

// ---- Queues -----------------------------------------------------------------------------------------------------------------------

ReadyKey Scheduler::KeyOf(TaskIndex index) const {
  const Task& task = tasks_[index];
  const JobPlace& place = task.wanted_by.front();
  return {place.job, static_cast<int>(place.place.kind), task.locality, place.place.index, index, task.memory_bytes};
}

void Scheduler::LeaveOrder(const std::string& name, const User& user) {
  for (const auto& [priority, queue] : user.queues) ready_users_.erase({-priority, user.running, user.served, name});
}

void Scheduler::EnterOrder(const std::string& name, User* user) {
  std::erase_if(user->queues, [](const auto& queue) { return queue.second.empty(); });
  if (options_.user_tasks_max != 0 && user->running >= options_.user_tasks_max && !TREM_PLANTED(kIgnoresUserLimit)) return;
  for (const auto& [priority, queue] : user->queues) ready_users_.insert({-priority, user->running, user->served, name});
}

std::uint64_t Scheduler::FreeMemory(const Worker& worker) {
  if (worker.memory_bytes_max == 0 || TREM_PLANTED(kIgnoresMemory)) return MemoryLimit(0);
  std::uint64_t used = 0;
  for (const auto& [key, slot] : worker.slots) used += slot.memory_bytes;
  return worker.memory_bytes_max - std::min(used, worker.memory_bytes_max);
}

void Scheduler::Enqueue(TaskIndex index) {
  Task& task = tasks_[index];
  const Job& job = jobs_.at(task.wanted_by.front().job);
  task.state = TaskState::kReady;
  ReadyQueue* queue = nullptr;
  if (const auto user = users_.find(job.user); user != users_.end()) {
    const auto found = user->second.queues.find(job.priority);
    if (found != user->second.queues.end()) queue = &found->second;
  }
  if (queue != nullptr) return queue->Insert(KeyOf(index));
  ChangeUser(job.user, [&](User& user) { user.queues[job.priority].Insert(KeyOf(index)); });
}

void Scheduler::Unqueue(TaskIndex index) {
  Task& task = tasks_[index];
  const Job& job = jobs_.at(task.wanted_by.front().job);
  ReadyQueue& queue = users_.at(job.user).queues.at(job.priority);
  TREM_CHECK(queue.Erase(KeyOf(index)));
  task.state = TaskState::kIdle;
  if (queue.empty()) {
    ChangeUser(job.user, [](User&) {});
  }
}

void Scheduler::Delay(TaskIndex index, std::uint64_t delay_ms) {
  Task& task = tasks_[index];
  task.state = TaskState::kDelayed;
  task.until_ms = now_ms_ + static_cast<TimeMs>(delay_ms);
  if (!TREM_PLANTED(kForgottenDelay)) delayed_.insert({task.until_ms, index});
}

// ---- Placement --------------------------------------------------------------------------------------------------------------------

const ReadyKey* Scheduler::FirstReady(std::uint64_t memory_bytes_max, const ReadyQueue** queue) const {
  for (const auto& [minus_priority, running, served, name] : ready_users_) {
    *queue = &users_.at(name).queues.at(-minus_priority);
    if (const ReadyKey* key = (*queue)->FindFirst({}, memory_bytes_max)) return key;
  }
  return nullptr;
}

// The idle worker for a task; `*wait`: it has failed on all that are idle, and there are others.
const std::string* Scheduler::PickWorker(TaskIndex index, bool* wait) const {
  const Task& task = tasks_[index];
  const auto tightest = idle_.lower_bound({task.memory_bytes, 0, {}});
  TREM_CHECK(tightest != idle_.end());
  if (task.trouble == nullptr) return &std::get<2>(*tightest);
  const std::vector<std::string>& failed_on = task.trouble->failed_on;
  for (auto worker = tightest; worker != idle_.end(); ++worker) {
    if (!Contains(failed_on, std::get<2>(*worker))) return &std::get<2>(*worker);
  }
  *wait = workers_.size() > failed_on.size() && task.trouble->waits < kWaitsMax;
  return &std::get<2>(*tightest);
}

// The task for a worker whose host has read other things than the next hosts: of the stage of `first`, in its host's group, else in one
// that no other host has begun, else `first`.
ReadyKey Scheduler::NearestTo(const Worker& worker, const std::string& worker_id, const ReadyQueue& queue, const ReadyKey& first) const {
  const std::uint64_t memory_bytes_max = FreeMemory(worker);
  const auto suits = [&](const ReadyKey* key) {
    if (key == nullptr || !key->SameStage(first)) return false;
    const Task& task = tasks_[key->task];
    return task.trouble == nullptr || !Contains(task.trouble->failed_on, worker_id);
  };
  const ReadyKey& last = hosts_.at(worker.host).last;
  if (last.SameStage(first)) {
    const ReadyKey* key = queue.FindFirst({last.job, last.kind, last.locality, 0, 0, 0}, memory_bytes_max);
    if (suits(key) && key->SameGroup(last)) return *key;
  }
  const ReadyKey* key = &first;
  for (int i = 0; i < kGroupsLookedAt && suits(key); ++i) {
    const auto group = groups_.find({key->job, key->kind, key->locality});
    if (group == groups_.end() || group->second == worker.host) return *key;
    key = queue.FindFirst({key->job, key->kind, key->locality + 1, 0, 0, 0}, memory_bytes_max);
  }
  return first;
}

void Scheduler::DispatchReady() {
  while (!idle_.empty()) {
    const ReadyQueue* queue = nullptr;
    const ReadyKey* first = FirstReady(std::get<0>(*idle_.rbegin()), &queue);
    if (first == nullptr) return;
    bool wait = false;
    const std::string worker_id = *PickWorker(first->task, &wait);
    if (wait) {
      const TaskIndex index = first->task;
      ++TroubleOf(index).waits;
      Unqueue(index);
      Delay(index, options_.retry_delay_ms);
      continue;
    }
    const ReadyKey chosen = NearestTo(workers_.at(worker_id), worker_id, *queue, *first);
    Unqueue(chosen.task);
    Dispatch(worker_id, chosen.task, false);
  }
}

void Scheduler::Dispatch(const std::string& worker_id, TaskIndex index, bool is_hedge) {
  Task& task = tasks_[index];
  const std::uint32_t number = TREM_PLANTED(kReusedNumber) && task.newest_attempt > 0 ? task.newest_attempt : ++task.newest_attempt;
  v1::LogEvent log;
  log.mutable_attempt_started()->set_task_key(task.key);
  log.mutable_attempt_started()->set_attempt(number);
  log.mutable_attempt_started()->set_worker_id(worker_id);
  log.mutable_attempt_started()->set_hedge(is_hedge);
  Append(std::move(log));
  Lease lease;
  lease.attempt = number;
  lease.worker_id = worker_id;
  lease.until_ms = now_ms_ + options_.lease_ms;
  AddLease(index, lease);
  SetSlot(worker_id, task.key, {number, true, 0, task.memory_bytes});
  const std::string& host = workers_.at(worker_id).host;
  const ReadyKey key = KeyOf(index);
  hosts_.at(host).last = key;
  groups_.try_emplace({key.job, key.kind, key.locality}, host);
  const JobPlace& place = task.wanted_by.front();
  effects_.push_back(DispatchEffect{worker_id, jobs_.at(place.job).graph->Spec(place.place), number, options_.lease_ms});
}

// ---- Processors ------------------------------------------------------------------------------------------------------------------

void Scheduler::LeaveHost(const std::string& worker_id, const Worker& worker) {
  const auto host = hosts_.find(worker.host);
  if (host == hosts_.end()) return;
  const auto used = static_cast<std::uint32_t>(worker.slots.size());
  host->second.idle -= worker.is_draining ? 0 : worker.credit - std::min(worker.credit, used);
  host->second.busy -= used;
  host->second.busy_workers.erase(worker_id);
}

void Scheduler::EnterHost(const std::string& worker_id, const Worker& worker) {
  Host& host = hosts_[worker.host];
  const auto used = static_cast<std::uint32_t>(worker.slots.size());
  host.idle += worker.is_draining ? 0 : worker.credit - std::min(worker.credit, used);
  host.busy += used;
  if (used > 0) host.busy_workers.insert(worker_id);
  changed_hosts_.insert(worker.host);
}

void Scheduler::ShareProcessors() {
  for (const std::string& name : std::exchange(changed_hosts_, {})) {
    const auto found = hosts_.find(name);
    if (found == hosts_.end()) continue;
    Host& host = found->second;
    const std::uint32_t share = host.busy > 0 && host.busy <= kSharersMax ? 1 + host.idle / host.busy : 1;
    // All that run there have one, and keep it: nearly always.
    if (share == 1 && std::exchange(host.share, share) == 1) continue;
    host.share = share;
    for (const std::string& worker_id : host.busy_workers) {
      for (auto& [key, slot] : workers_.at(worker_id).slots) {
        if (!slot.live || slot.processors == share) continue;
        slot.processors = share;
        effects_.push_back(ShareEffect{worker_id, {key, slot.attempt}, share});
      }
    }
  }
}

// ---- Hedges -----------------------------------------------------------------------------------------------------------------------

// Idle workers are left when this is called: nothing that is ready fits them.
void Scheduler::HedgeStragglers() {
  if (options_.hedge_factor <= 0.0) return;
  int looked_at = 0;
  for (auto alone = alone_.begin(); alone != alone_.end() && !idle_.empty() && looked_at < kStragglersLookedAt; ++looked_at) {
    const auto [started_ms, index] = *alone++;
    if (now_ms_ - started_ms < options_.hedge_after_ms) return;  // The others began later.
    const Task& task = tasks_[index];
    const JobPlace& place = task.wanted_by.front();
    const std::optional<double> mean_ms = jobs_.at(place.job).graph->MeanElapsedMs(place.place.kind);
    if (!mean_ms || static_cast<double>(now_ms_ - started_ms) < options_.hedge_factor * *mean_ms) continue;
    const std::string& holder = leases_.at(index).front().worker_id;
    const auto held_by = workers_.find(holder);
    const std::string host = held_by == workers_.end() ? std::string() : held_by->second.host;
    const std::string* chosen = nullptr;
    auto worker = idle_.lower_bound({task.memory_bytes, 0, {}});
    for (int i = 0; i < kIdleLookedAt && worker != idle_.end(); ++i, ++worker) {
      const std::string& worker_id = std::get<2>(*worker);
      if (worker_id == holder || (task.trouble != nullptr && Contains(task.trouble->failed_on, worker_id))) continue;
      if (chosen == nullptr) chosen = &worker_id;
      if (workers_.at(worker_id).host == host) continue;
      chosen = &worker_id;
      break;
    }
    if (chosen == nullptr) continue;
    effects_.push_back(LogEffect{TitleOf(task) + " runs for " + std::to_string(now_ms_ - started_ms) +
                                     " ms, others took a fraction of that: a second attempt begins beside it",
                                 task.key});
    if (!TREM_PLANTED(kEndlessHedges)) alone_.erase({started_ms, index});
    Dispatch(std::string(*chosen), index, true);
  }
}

}  // namespace trem
