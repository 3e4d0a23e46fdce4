#include "tests/unit/coordinator/scheduling/simulation.h"

#include <algorithm>

#include "mosaic/base/check.h"

namespace trem::testing {
namespace {

constexpr TimeMs kStepMs = 50;
constexpr TimeMs kSilenceMs = 2'000;  // Either side takes the other for gone.
constexpr TimeMs kTaskMsMax = 3'000;
constexpr TimeMs kFaultyMs = 60'000;    // How long faults last.
constexpr TimeMs kPeaceMs = 3'600'000;  // How long the jobs may take to end then.

}  // namespace

Simulation::Simulation(std::uint64_t seed) : seed_(seed), rng_({seed, 0x73696d}) {
  options_.lease_ms = 4'000;
  options_.retry_delay_ms = 200;
  options_.restart_grace_ms = 1'000;
  // Faults are far more frequent than in life: the limits must not end the jobs that the checks are about.
  options_.failures_max = 1'000;
  options_.losses_max = 1'000;
  options_.outages_max = 1'000;
  options_.hedge_factor = 0.0;
  scheduler_ = Scheduler(options_);
}

bool Simulation::Chance(double probability) { return rng_.Uniform() < probability; }

bool Simulation::Fault(const char* name, double probability) {
  if (!faults_on_ || !Chance(probability)) return false;
  ++faults_.counts[name];
  return true;
}

TimeMs Simulation::Between(TimeMs low, TimeMs high) {
  return low + static_cast<TimeMs>(rng_.UniformIndex(static_cast<std::uint32_t>(high - low + 1)));
}

void Simulation::Complain(const std::string& text) {
  violations_.push_back("seed " + std::to_string(seed_) + " at " + std::to_string(now_ms_) + " ms: " + text);
}

// ---- Network ----------------------------------------------------------------------------------------------------------------------

void Simulation::Post(Message message) {
  if (Fault("message lost", 0.05)) return;
  TimeMs delay_ms = Between(0, 20);
  if (Fault("message overtaken", 0.05)) delay_ms = Between(0, 500);
  if (Fault("message late", 0.01)) delay_ms = Between(1'000, 15'000);
  if (Fault("message doubled", 0.03)) network_.emplace(now_ms_ + Between(0, 5'000), message);
  network_.emplace(now_ms_ + delay_ms, std::move(message));
}

void Simulation::DeliverDue() {
  while (!network_.empty() && network_.begin()->first <= now_ms_) {
    const Message message = std::move(network_.extract(network_.begin()).mapped());
    if (const auto* event = std::get_if<Event>(&message.body)) {
      ToCoordinator(message.worker_id, *event);
    } else if (const auto worker = workers_.find(message.worker_id); worker != workers_.end() && worker->second.hung_until_ms <= now_ms_) {
      ToWorker(worker->second, message);
    }
  }
}

// The shell's part: whoever is not known has to say Hello first.
void Simulation::ToCoordinator(const std::string& worker_id, const Event& event) {
  if (std::holds_alternative<WorkerHelloEvent>(event)) {
    Post({worker_id, Welcome{}});
  } else if (last_heard_ms_.count(worker_id) == 0) {
    Post({worker_id, SayHello{}});
    return;
  }
  last_heard_ms_[worker_id] = now_ms_;
  Feed(event);
  if (std::holds_alternative<WorkerGoodbyeEvent>(event)) last_heard_ms_.erase(worker_id);
}

// ---- Workers ----------------------------------------------------------------------------------------------------------------------

void Simulation::AddWorker() {
  SimWorker worker;
  worker.id = "w" + std::to_string(worker_count_++);
  workers_[worker.id] = worker;
}

void Simulation::PostHello(SimWorker& worker) {
  WorkerHelloEvent event;
  event.worker_id = worker.id;
  event.credit = 1;
  for (const Work& work : worker.work) event.running.push_back({work.task.key(), work.attempt});
  for (const Result& result : worker.results) event.running.push_back(result.event.attempt);
  worker.hello_ms = now_ms_ + 1'000;
  Post({worker.id, Event(event)});
}

void Simulation::ToWorker(SimWorker& worker, const Message& message) {
  worker.heard_ms = now_ms_;
  if (std::holds_alternative<Welcome>(message.body)) {
    worker.welcome = true;
    return;
  }
  if (std::holds_alternative<SayHello>(message.body)) {
    worker.welcome = false;
    worker.hello_ms = now_ms_;
    return;
  }
  const Effect& effect = std::get<Effect>(message.body);
  if (const auto* dispatch = std::get_if<DispatchEffect>(&effect)) OnDispatch(worker, *dispatch);
  if (const auto* cancel = std::get_if<CancelTaskEffect>(&effect)) OnCancel(worker, *cancel);
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
      work.cancelled = true;
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

void Simulation::FinishWork(SimWorker& worker) {
  const Work work = worker.work.front();
  worker.work.pop_front();
  TaskDoneEvent event;
  event.worker_id = worker.id;
  event.attempt = {work.task.key(), work.attempt};
  event.elapsed_ms = 100;
  if (work.cancelled) {
    event.code = StatusCode::kCancelled;
  } else if (Fault("task failed for now", 0.1)) {
    event.code = StatusCode::kUnavailable;
    event.message = "mount is gone";
  } else if (Fault("task gave up", 0.02)) {
    event.code = StatusCode::kCancelled;
  } else {
    event.result = FakeResult(work.task);
  }
  worker.results.push_back({event, now_ms_});
}

void Simulation::RunWorker(SimWorker& worker) {
  if (worker.hung_until_ms > now_ms_) return;
  if (!worker.work.empty() && (worker.work.front().cancelled || worker.work.front().ends_ms <= now_ms_)) FinishWork(worker);
  if (now_ms_ - worker.heard_ms > kSilenceMs) worker.welcome = false;
  if (!worker.welcome) {
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
  if (worker.work.empty()) {
    // A heartbeat: only the shell hears it.
    if (!Fault("message lost", 0.05)) {
      if (last_heard_ms_.count(worker.id) > 0) {
        last_heard_ms_[worker.id] = now_ms_;
      } else {
        Post({worker.id, SayHello{}});
      }
    }
  } else {
    Post({worker.id, Event(ProgressEvent{worker.id, {worker.work.front().task.key(), worker.work.front().attempt}, 0.5})});
  }
}

void Simulation::DisturbWorkers() {
  std::vector<std::string> gone;
  for (auto& [id, worker] : workers_) {
    if (Fault("worker crashed", 0.004)) gone.push_back(id);
    if (Fault("worker hung", 0.004)) worker.hung_until_ms = now_ms_ + Between(100, 15'000);
    if (!worker.work.empty() && Fault("task hung", 0.004)) worker.work.front().ends_ms = now_ms_ + Between(5'000, 20'000);
    if (worker.hung_until_ms <= now_ms_ && Fault("worker left", 0.001)) {
      Post({id, Event(WorkerGoodbyeEvent{id})});
      gone.push_back(id);
    }
  }
  for (const std::string& id : gone) workers_.erase(id);
  if (workers_.size() < 3 && Chance(0.05)) AddWorker();
}

// ---- Coordinator ------------------------------------------------------------------------------------------------------------------

void Simulation::CheckEffect(const Effect& effect) {
  if (const auto* dispatch = std::get_if<DispatchEffect>(&effect)) {
    const std::string& key = dispatch->task.key();
    if (committed_.count(key) > 0) Complain("a committed task was handed out again");
    if (dispatch->attempt <= newest_dispatch_[key]) Complain("attempt " + std::to_string(dispatch->attempt) + " was handed out twice");
    if (live_.count(key) > 0) Complain("a task was handed out while worker " + live_[key].first + " has its lease");
    newest_dispatch_[key] = dispatch->attempt;
    live_[key] = {dispatch->worker_id, dispatch->attempt};
  }
  if (const auto* cancel = std::get_if<CancelTaskEffect>(&effect)) {
    const auto lease = live_.find(cancel->attempt.task_key);
    if (lease != live_.end() && lease->second == std::pair(cancel->worker_id, cancel->attempt.number)) live_.erase(lease);
  }
  if (const auto* append = std::get_if<AppendEffect>(&effect); append != nullptr && append->event.has_task_committed()) {
    const v1::TaskCommitted& committed = append->event.task_committed();
    if (!committed_.insert(committed.task_key()).second) Complain("a key was committed twice");
    if (committed.attempt() != newest_dispatch_[committed.task_key()]) Complain("the result of an old attempt was committed");
  }
  if (const auto* append = std::get_if<AppendEffect>(&effect); append != nullptr && append->event.has_result_differed()) {
    Complain("equal results were reported as different");
  }
}

// Leases end when their result arrives or their holder is lost, leaves, or comes back without naming them; also by CancelTask (see
// CheckEffect). A holder that comes back and names the newest attempt has the lease (again).
void Simulation::NoteEndsOfLeases(const Event& event) {
  std::string worker_id;
  std::set<Attempt> named;
  if (const auto* lost = std::get_if<WorkerLostEvent>(&event)) worker_id = lost->worker_id;
  if (const auto* left = std::get_if<WorkerGoodbyeEvent>(&event)) worker_id = left->worker_id;
  if (const auto* hello = std::get_if<WorkerHelloEvent>(&event)) {
    worker_id = hello->worker_id;
    named.insert(hello->running.begin(), hello->running.end());
  }
  std::erase_if(live_, [&](const auto& lease) {
    return lease.second.first == worker_id && named.count({lease.first, lease.second.second}) == 0;
  });
  if (const auto* done = std::get_if<TaskDoneEvent>(&event)) {
    const auto lease = live_.find(done->attempt.task_key);
    if (lease != live_.end() && lease->second.second == done->attempt.number) live_.erase(lease);
  }
  for (const Attempt& attempt : named) {
    const bool newest = newest_dispatch_[attempt.task_key] == attempt.number && committed_.count(attempt.task_key) == 0;
    if (newest && live_.count(attempt.task_key) == 0) live_[attempt.task_key] = {worker_id, attempt.number};
  }
}

void Simulation::Feed(const Event& event) {
  const std::vector<Effect> effects = scheduler_.Step(now_ms_, event);
  if (Fault("coordinator died before its log was written", 0.003)) {
    Restart();
    return;
  }
  NoteEndsOfLeases(event);
  for (const Effect& effect : effects) CheckEffect(effect);
  for (const AppendEffect& append : Only<AppendEffect>(effects)) disk_.push_back(append.event);
  for (const Effect& effect : effects) {
    if (Fault("coordinator died while it sent", 0.01)) {
      Restart();
      return;
    }
    if (const auto* dispatch = std::get_if<DispatchEffect>(&effect)) Post({dispatch->worker_id, effect});
    if (const auto* ack = std::get_if<AckEffect>(&effect)) Post({ack->worker_id, effect});
    if (const auto* cancel = std::get_if<CancelTaskEffect>(&effect)) Post({cancel->worker_id, effect});
  }
  for (const v1::JobStatus& status : scheduler_.JobStatuses()) {
    for (const v1::StageStatus& stage : status.stages()) {
      if (stage.running() > stage.total() - stage.done()) Complain("more tasks run than are left: one has two live leases");
    }
  }
}

void Simulation::Restart() {
  scheduler_ = Scheduler(options_);
  for (const v1::LogEvent& event : disk_) {
    const trem::Status status = scheduler_.Restore(event);
    if (!status.ok()) Complain("the log cannot be replayed: " + status.ToString());
  }
  last_heard_ms_.clear();
  live_.clear();
}

void Simulation::CoordinatorTick() {
  std::vector<std::string> lost;
  for (const auto& [worker_id, heard_ms] : last_heard_ms_) {
    if (now_ms_ - heard_ms > kSilenceMs) lost.push_back(worker_id);
  }
  for (const std::string& worker_id : lost) {
    last_heard_ms_.erase(worker_id);
    Feed(WorkerLostEvent{worker_id});
  }
  Feed(TickEvent{});
  // Heartbeats to those it knows.
  for (auto& [id, worker] : workers_) {
    if (last_heard_ms_.count(id) > 0 && worker.hung_until_ms <= now_ms_ && !Fault("message lost", 0.05)) worker.heard_ms = now_ms_;
  }
}

// The client's part: it asks until it sees its job.
void Simulation::Submit(const std::string& job_id) {
  if (scheduler_.FindSortie(job_id) == nullptr) Feed(SubmitJobEvent{job_id, FakeSortie(submitted_.at(job_id)), "", 0});
}

bool Simulation::AllJobsEnded() const {
  return std::all_of(submitted_.begin(), submitted_.end(), [this](const auto& job) {
    const auto status = scheduler_.JobStatus(job.first);
    return status.has_value() && status->state() != v1::JOB_RUNNING;
  });
}

void Simulation::CheckOutputs() {
  for (const auto& [job_id, sortie_name] : submitted_) {
    const v1::JobStatus status = *scheduler_.JobStatus(job_id);
    if (cancelled_.count(job_id) > 0) {
      if (status.state() == v1::JOB_FAILED) Complain("a cancelled job failed: " + status.error());
      continue;
    }
    if (status.state() != v1::JOB_DONE) {
      Complain("job " + job_id + " ended as " + v1::JobState_Name(status.state()) + ": " + status.error());
      continue;
    }
    // What one worker without any fault makes of it.
    Bench bench;
    bench.Hello("w");
    bench.RunAll(bench.Submit(job_id, sortie_name));
    const v1::JobStatus expected = bench.Status(job_id);
    if (status.outputs_size() != 1 || status.outputs(0).sha256() != expected.outputs(0).sha256()) {
      Complain("job " + job_id + " has other outputs than without faults");
    }
  }
  if (scheduler_.has_running()) Complain("a lease outlives its job");
}

std::vector<std::string> Simulation::Run() {
  for (int i = 0; i < 3; ++i) AddWorker();
  const TimeMs faults_end_ms = now_ms_ + kFaultyMs;
  const TimeMs peace_end_ms = faults_end_ms + kPeaceMs;
  submitted_["a"] = "leg";
  if (Chance(0.5)) submitted_["b"] = Chance(0.5) ? "leg" : "other";
  const std::string to_cancel = Chance(0.3) ? "b" : "";
  while (true) {
    faults_on_ = now_ms_ < faults_end_ms;
    if (!faults_on_ && workers_.empty()) AddWorker();
    for (const auto& [job_id, name] : submitted_) Submit(job_id);
    if (faults_on_ && submitted_.count(to_cancel) > 0 && Fault("job cancelled", 0.002)) {
      Feed(CancelJobEvent{to_cancel});
      // When the coordinator dies before it is written down, the client sees a running job and may leave it so.
      cancelled_.insert(to_cancel);
    }
    DeliverDue();
    for (auto& [id, worker] : workers_) RunWorker(worker);
    if (faults_on_) DisturbWorkers();
    CoordinatorTick();
    if (AllJobsEnded()) break;
    if (now_ms_ > peace_end_ms) {
      Complain("the jobs do not end although the faults have");
      return violations_;
    }
    now_ms_ += kStepMs;
  }
  CheckOutputs();
  return violations_;
}

}  // namespace trem::testing
