// The workers of the simulated world, and what happens to them.
#include <algorithm>

#include "coordinator/planning/memory_estimate.h"
#include "tests/unit/coordinator/scheduling/simulation.h"

namespace trem::testing {
namespace {

constexpr TimeMs kSilenceMs = 2'000;  // A worker takes the coordinator for gone.
constexpr TimeMs kTaskMsMax = 1'500;
constexpr std::uint32_t kPoisonedWindow = 1;

}  // namespace

void Simulation::AddWorker() {
  SimWorker worker;
  worker.id = "w" + std::to_string(worker_count_++);
  worker.host = Chance(0.5) ? "a" : "b";
  worker.credit = Chance(0.3) ? 2 : 1;
  // Room for every task, but not for two of the largest.
  if (Chance(0.3)) worker.memory_bytes_max = IngestMemoryBytes() + IngestMemoryBytes() / 4;
  workers_[worker.id] = worker;
}

void Simulation::PostHello(SimWorker& worker) {
  WorkerHelloEvent event;
  event.worker_id = worker.id;
  event.host = worker.host;
  event.credit = worker.is_draining ? 0 : worker.credit;
  event.memory_bytes_max = worker.memory_bytes_max;
  for (const Work& work : worker.work) event.running.push_back({work.task.key(), work.attempt});
  for (const Result& result : worker.results) event.running.push_back(result.event.attempt);
  worker.hello_ms = now_ms_ + 1'000;
  Post({worker.id, Event(event)});
}

void Simulation::ToWorker(SimWorker& worker, const Message& message) {
  worker.heard_ms = now_ms_;
  if (std::holds_alternative<Welcome>(message.body)) {
    worker.is_welcome = true;
    return;
  }
  if (std::holds_alternative<SayHello>(message.body)) {
    worker.is_welcome = false;
    worker.hello_ms = now_ms_;
    return;
  }
  const Effect& effect = std::get<Effect>(message.body);
  if (const auto* dispatch = std::get_if<DispatchEffect>(&effect)) OnDispatch(worker, *dispatch);
  if (const auto* cancel = std::get_if<CancelTaskEffect>(&effect)) OnCancel(worker, *cancel);
  if (std::holds_alternative<DrainWorkerEffect>(effect)) worker.is_draining = true;
  if (const auto* ack = std::get_if<AckEffect>(&effect)) {
    std::erase_if(worker.results, [&](const Result& result) { return result.event.attempt == ack->attempt; });
  }
}

void Simulation::OnDispatch(SimWorker& worker, const DispatchEffect& dispatch) {
  const bool has_it = std::any_of(worker.work.begin(), worker.work.end(), [&](const Work& work) {
    return work.task.key() == dispatch.task.key() && work.attempt >= dispatch.attempt;
  });
  if (has_it) return;
  worker.work.push_back({dispatch.task, dispatch.attempt, now_ms_ + Between(10, kTaskMsMax), false});
}

void Simulation::OnCancel(SimWorker& worker, const CancelTaskEffect& cancel) {
  for (Work& work : worker.work) {
    if (Attempt{work.task.key(), work.attempt} == cancel.attempt) {
      work.is_cancelled = true;
      return;
    }
  }
  TaskDoneEvent event;
  event.worker_id = worker.id;
  event.attempt = cancel.attempt;
  event.code = StatusCode::kCancelled;
  std::erase_if(worker.results, [&](const Result& result) { return result.event.attempt == cancel.attempt; });
  Post({worker.id, Event(event)});
}

bool Simulation::IsPoisoned(const v1::TaskSpec& task) const {
  return task.kind() == v1::ENHANCE && task.enhance().window_id() == kPoisonedWindow && FakeSortieNameOf(task) == poisoned_sortie_ &&
         !is_healed_;
}

void Simulation::FinishWork(SimWorker& worker) {
  const Work work = worker.work.front();
  worker.work.pop_front();
  TaskDoneEvent event;
  event.worker_id = worker.id;
  event.attempt = {work.task.key(), work.attempt};
  event.elapsed_ms = 100;
  for (const v1::ArtefactRef& input : work.task.inputs()) {
    if (damaged_.count(input.sha256()) > 0) event.bad_artefacts.push_back(input.sha256());
  }
  if (work.is_cancelled) {
    event.code = StatusCode::kCancelled;
  } else if (!event.bad_artefacts.empty()) {
    event.code = StatusCode::kCorrupt;
  } else if (IsPoisoned(work.task)) {
    event.code = StatusCode::kFailed;
    event.message = "poison";
  } else if (Fault("task failed for now", 0.1)) {
    event.code = Chance(0.5) ? StatusCode::kUnavailable : StatusCode::kExhausted;
    event.message = "mount is gone";
  } else if (Fault("task gave up", 0.02)) {
    event.code = StatusCode::kCancelled;
  } else {
    event.result = FakeResult(work.task);
    for (const v1::ArtefactRef& output : event.result.outputs()) {
      stored_.push_back(output.sha256());
      damaged_.erase(output.sha256());
    }
  }
  worker.results.push_back({event, now_ms_});
}

void Simulation::RunWorker(SimWorker& worker) {
  if (worker.hung_until_ms > now_ms_) return;
  if (!worker.work.empty() && (worker.work.front().is_cancelled || worker.work.front().ends_ms <= now_ms_)) FinishWork(worker);
  if (now_ms_ - worker.heard_ms > kSilenceMs) worker.is_welcome = false;
  if (!worker.is_welcome) {
    if (now_ms_ >= worker.hello_ms) PostHello(worker);
    return;
  }
  for (Result& result : worker.results) {
    if (now_ms_ < result.resend_ms) continue;
    result.resend_ms = now_ms_ + 1'000;
    Post({worker.id, Event(result.event)});
    if (Fault("result sent twice", 0.05)) Post({worker.id, Event(result.event)});
  }
  if (now_ms_ < worker.next_progress_ms) return;
  worker.next_progress_ms = now_ms_ + 400;
  if (!worker.work.empty()) {
    Post({worker.id, Event(ProgressEvent{worker.id, {worker.work.front().task.key(), worker.work.front().attempt}, 0.5})});
    return;
  }
  // A heartbeat: only the shell hears it, when it listens.
  if (worker.cut_until_ms > now_ms_ || busy_until_ms_ > now_ms_ || Fault("message lost", 0.05)) return;
  if (last_heard_ms_.count(worker.id) > 0) {
    last_heard_ms_[worker.id] = now_ms_;
  } else {
    Post({worker.id, SayHello{}});
  }
}

void Simulation::DisturbWorkers() {
  std::vector<std::string> gone;
  for (auto& [id, worker] : workers_) {
    if (Fault("worker crashed", 0.004)) gone.push_back(id);
    if (Fault("worker hung", 0.004)) worker.hung_until_ms = now_ms_ + Between(100, 10'000);
    if (Fault("link cut", 0.004)) worker.cut_until_ms = now_ms_ + Between(100, 10'000);
    if (!worker.work.empty() && Fault("task hung", 0.004)) worker.work.front().ends_ms = now_ms_ + Between(5'000, 15'000);
    if (worker.hung_until_ms <= now_ms_ && Fault("worker left", 0.001)) {
      Post({id, Event(WorkerGoodbyeEvent{id})});
      gone.push_back(id);
    }
    if (busy_until_ms_ <= now_ms_ && Fault("worker drained", 0.001)) Feed(DrainWorkerEvent{id});
  }
  for (const std::string& id : gone) workers_.erase(id);
}

}  // namespace trem::testing
