#include "tests/unit/coordinator/scheduling/checker.h"

#include <algorithm>

#include "tests/unit/coordinator/scheduling/fake_tasks.h"

namespace trem::testing {

void Checker::Restart() {
  live_.clear();
  workers_.clear();
  restored_ = newest_;
}

std::uint32_t Checker::FailuresOf(const std::string& key) const {
  const auto found = failures_.find(key);
  return found == failures_.end() ? 0 : found->second;
}

void Checker::Step(TimeMs now_ms, const Event& event, const std::vector<Effect>& effects) {
  now_ms_ = now_ms;
  done_ = std::get_if<TaskDoneEvent>(&event);
  done_was_due_ = done_was_committed_ = false;
  TakeEvent(event);
  for (const Effect& effect : effects) TakeEffect(effect);
  if (done_was_due_ && !done_was_committed_) Complain("the result of a leased attempt was dropped");
  if (std::holds_alternative<TickEvent>(event)) CheckLeases();
}

// What an event does to leases, before the scheduler says anything.
void Checker::TakeEvent(const Event& event) {
  if (const auto* hello = std::get_if<WorkerHelloEvent>(&event)) {
    WorkerRecord& worker = workers_[hello->worker_id];
    worker.credit = hello->credit;
    worker.memory_bytes_max = hello->memory_bytes_max;
    const std::set<Attempt> named(hello->running.begin(), hello->running.end());
    std::map<std::string, std::uint64_t> held;
    for (const Attempt& attempt : named) held[attempt.task_key] = worker.held.count(attempt.task_key) ? worker.held[attempt.task_key] : 0;
    worker.held = held;
    worker.held_until_ms.clear();
    for (auto& [key, holders] : live_) {
      std::erase_if(holders, [&](const auto& holder) {
        return holder.second.worker_id == hello->worker_id && named.count({key, holder.first}) == 0;
      });
    }
    // It goes on with what is the newest hand-out and with nobody else.
    for (const Attempt& attempt : named) {
      auto& holders = live_[attempt.task_key];
      const auto known = newest_.find(attempt.task_key);
      const bool is_newest = known != newest_.end() && known->second == attempt.number;
      const bool is_its_own = holders.count(attempt.number) > 0 && holders[attempt.number].worker_id == hello->worker_id;
      if (committed_.count(attempt.task_key) > 0 || !(is_its_own || (is_newest && holders.empty()))) continue;
      holders[attempt.number] = {hello->worker_id, now_ms_ + options_.lease_ms};
    }
    return;
  }
  std::string gone;
  if (const auto* lost = std::get_if<WorkerLostEvent>(&event)) gone = lost->worker_id;
  if (const auto* left = std::get_if<WorkerGoodbyeEvent>(&event)) gone = left->worker_id;
  if (!gone.empty()) {
    for (auto& [key, holders] : live_) {
      std::erase_if(holders, [&](const auto& holder) { return holder.second.worker_id == gone; });
    }
    workers_.erase(gone);
  }
  if (const auto* drain = std::get_if<DrainWorkerEvent>(&event); drain != nullptr && workers_.count(drain->worker_id) > 0) {
    workers_[drain->worker_id].is_draining = true;
  }
  if (const auto* progress = std::get_if<ProgressEvent>(&event)) {
    const auto holders = live_.find(progress->attempt.task_key);
    if (holders != live_.end()) {
      const auto holder = holders->second.find(progress->attempt.number);
      if (holder != holders->second.end() && holder->second.worker_id == progress->worker_id) {
        holder->second.until_ms = now_ms_ + options_.lease_ms;
      }
    }
  }
  if (done_ == nullptr) return;
  const std::string& key = done_->attempt.task_key;
  if (const auto worker = workers_.find(done_->worker_id); worker != workers_.end()) worker->second.held.erase(key);
  const auto holders = live_.find(key);
  const bool was_live = holders != live_.end() && holders->second.erase(done_->attempt.number) > 0;
  // The newest one may be leased to whoever held it before a restart.
  const bool counts = was_live || newest_[key] == done_->attempt.number;
  if (done_->code != StatusCode::kOk && done_->code != StatusCode::kCancelled && counts) ++failures_[key];
  if (done_->code == StatusCode::kOk && was_live) done_was_due_ = committed_.count(key) == 0;
}

void Checker::TakeEffect(const Effect& effect) {
  if (const auto* append = std::get_if<AppendEffect>(&effect)) OnAppend(append->event);
  if (const auto* dispatch = std::get_if<DispatchEffect>(&effect)) OnDispatch(*dispatch);
  if (const auto* cancel = std::get_if<CancelTaskEffect>(&effect)) {
    // The slot stays taken until the worker says that it has let go, or is silent about it for a lease.
    if (const auto worker = workers_.find(cancel->worker_id);
        worker != workers_.end() && worker->second.held.count(cancel->attempt.task_key)) {
      worker->second.held_until_ms[cancel->attempt.task_key] = now_ms_ + options_.lease_ms;
    }
    const auto holders = live_.find(cancel->attempt.task_key);
    if (holders == live_.end()) return;
    const auto holder = holders->second.find(cancel->attempt.number);
    if (holder != holders->second.end() && holder->second.worker_id == cancel->worker_id) holders->second.erase(holder);
  }
  if (const auto* ack = std::get_if<AckEffect>(&effect); ack != nullptr && done_ != nullptr) {
    if (done_was_due_ && !done_was_committed_) Complain("a result was acknowledged before it was written down");
    if (done_->code == StatusCode::kOk && committed_.count(ack->attempt.task_key) > 0) acknowledged_.insert(ack->attempt.task_key);
  }
}

void Checker::OnDispatch(const DispatchEffect& dispatch) {
  const std::string& key = dispatch.task.key();
  if (committed_.count(key) > 0)
    Complain("a committed task was handed out again: " + TitleOf(dispatch) + " of sortie " + FakeSortieNameOf(dispatch.task));
  if (dispatch.attempt <= newest_[key]) Complain("attempt " + std::to_string(dispatch.attempt) + " was handed out twice");
  newest_[key] = std::max(newest_[key], dispatch.attempt);
  auto& holders = live_[key];
  const bool is_hedge = hedges_.count({key, dispatch.attempt}) > 0;
  if (!is_hedge) restored_.erase(key);
  if (holders.size() > (is_hedge ? 1U : 0U)) {
    Complain("a task was handed out while worker " + holders.begin()->second.worker_id + " has its lease");
  }
  holders[dispatch.attempt] = {dispatch.worker_id, now_ms_ + options_.lease_ms};
  const auto worker = workers_.find(dispatch.worker_id);
  if (worker == workers_.end()) return Complain("a task was handed to worker " + dispatch.worker_id + ", which is gone");
  std::erase_if(worker->second.held, [&](const auto& held) {
    const auto until = worker->second.held_until_ms.find(held.first);
    return until != worker->second.held_until_ms.end() && until->second <= now_ms_;
  });
  worker->second.held_until_ms.erase(key);
  if (worker->second.is_draining) Complain("a task was handed to a worker that drains");
  sortie_of_[key] = FakeSortieNameOf(dispatch.task);
  if (dispatch.task.kind() == v1::INGEST) ingests_.insert(key);
  if (!is_hedge) CheckUserLimit(sortie_of_[key]);
  worker->second.held[key] = dispatch.task.memory_bytes();
  if (worker->second.held.size() > worker->second.credit) Complain("a worker was given more than its credit");
  std::uint64_t memory_bytes = 0;
  for (const auto& [held, bytes] : worker->second.held) memory_bytes += bytes;
  if (worker->second.memory_bytes_max != 0 && memory_bytes > worker->second.memory_bytes_max) {
    Complain("a worker was given more than its memory holds");
  }
}

void Checker::OnAppend(const v1::LogEvent& event) {
  if (event.has_attempt_started() && event.attempt_started().hedge()) {
    hedges_.insert({event.attempt_started().task_key(), event.attempt_started().attempt()});
  }
  if (event.has_task_committed()) {
    const v1::TaskCommitted& committed = event.task_committed();
    if (!committed_.insert(committed.task_key()).second) Complain("a key was committed twice");
    const bool may_be_leased = restored_.count(committed.task_key()) > 0 && restored_[committed.task_key()] == committed.attempt();
    if (!done_was_due_ && !may_be_leased && committed.attempt() != newest_[committed.task_key()])
      Complain("the result of an old attempt was committed");
    done_was_committed_ = true;
    forgotten_.erase(committed.task_key());
  }
  if (event.has_job_submitted()) users_of_[event.job_submitted().sortie().name()].insert(event.job_submitted().user());
  if (event.has_job_removed()) ForgetUnused();
  if (event.has_result_differed()) Complain("equal results were reported as different");
  if (event.has_task_invalidated()) committed_.erase(event.task_invalidated().task_key());
  if (event.has_task_quarantined()) {
    const std::string& key = event.task_quarantined().task_key();
    if (FailuresOf(key) < options_.failures_max) {
      Complain("a task was given up after " + std::to_string(FailuresOf(key)) + " failures");
    }
  }
}

// Of a sortie that only one user has ever submitted every lease is on that user's account.
void Checker::CheckUserLimit(const std::string& sortie) {
  if (options_.user_tasks_max == 0 || users_of_[sortie].size() != 1) return;
  std::size_t running = 0;
  for (const auto& [key, holders] : live_) running += !holders.empty() && sortie_of_[key] == sortie ? 1 : 0;
  if (running > options_.user_tasks_max) Complain("a user has more tasks running than the limit");
}

// What a removed job had may be computed again, unless a job that is done has it too.
void Checker::ForgetUnused() {
  for (auto key = committed_.begin(); key != committed_.end();) {
    if (ingests_.count(*key) == 0 && done_sorties_.count(sortie_of_[*key]) > 0) {
      ++key;
      continue;
    }
    forgotten_.insert(*key);
    acknowledged_.erase(*key);
    key = committed_.erase(key);
  }
}

// Nobody holds a lease longer than its time, or on a task that is finished.
void Checker::CheckLeases() {
  for (const auto& [key, holders] : live_) {
    for (const auto& [number, holder] : holders) {
      if (holder.until_ms <= now_ms_) Complain("worker " + holder.worker_id + " keeps a lease that it did not renew");
      if (committed_.count(key) > 0) Complain("worker " + holder.worker_id + " was not told that its task is finished");
    }
  }
}

void Checker::CheckLog(const std::vector<v1::LogEvent>& log) {
  std::set<std::string> in_log;
  for (const v1::LogEvent& event : log) {
    if (event.has_task_committed()) in_log.insert(event.task_committed().task_key());
    if (event.has_task_invalidated()) in_log.erase(event.task_invalidated().task_key());
  }
  for (const std::string& key : forgotten_) in_log.erase(key);
  for (const std::string& key : acknowledged_) {
    if (committed_.count(key) > 0 && in_log.count(key) == 0) Complain("an acknowledged result is not in the log");
  }
  committed_ = in_log;
}

}  // namespace trem::testing
