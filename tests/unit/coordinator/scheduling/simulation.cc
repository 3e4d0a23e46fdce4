// The simulated world: network, coordinator, disk, clock.
#include "tests/unit/coordinator/scheduling/simulation.h"

#include <algorithm>

#include "mosaic/base/check.h"

namespace trem::testing {
namespace {

constexpr TimeMs kStepMs = 50;
constexpr TimeMs kSilenceMs = 2'000;    // The coordinator takes a worker for gone.
constexpr TimeMs kFaultyMs = 30'000;    // How long faults last.
constexpr TimeMs kPeaceMs = 1'800'000;  // How long the jobs may take to end then.

}  // namespace

Simulation::Simulation(std::uint64_t seed, ShellFault shell_fault)
    : seed_(seed), shell_fault_(shell_fault), rng_({seed, 0x73696d}), checker_({}) {
  options_.lease_ms = 4'000;
  options_.retry_delay_ms = 200;
  options_.exhausted_delay_ms = 300;
  options_.retry_delay_ms_max = 2'000;
  options_.restart_grace_ms = 1'000;
  options_.hedge_after_ms = 2'000;
  // Faults are far more frequent than in life: the limits must not end the jobs that the checks are about.
  options_.outages_max = 1'000;
  options_.losses_max = 1'000;
  options_.repairs_max = 1'000;
  if (seed % 4 == 0) options_.user_tasks_max = 2;
  scheduler_ = Scheduler(options_);
  checker_ = Checker(options_);
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
  if (const auto worker = workers_.find(message.worker_id); worker != workers_.end() && worker->second.cut_until_ms > now_ms_) return;
  if (Fault("message lost", 0.05)) return;
  TimeMs delay_ms = Between(0, 20);
  if (Fault("message overtaken", 0.05)) delay_ms = Between(0, 500);
  if (Fault("message late", 0.01)) delay_ms = Between(1'000, 15'000);
  if (Fault("message doubled", 0.03)) network_.emplace(now_ms_ + Between(0, 5'000), message);
  network_.emplace(now_ms_ + delay_ms, std::move(message));
}

void Simulation::DeliverDue() {
  std::vector<Message> due;
  while (!network_.empty() && network_.begin()->first <= now_ms_) due.push_back(std::move(network_.extract(network_.begin()).mapped()));
  for (const Message& message : due) {
    const auto worker = workers_.find(message.worker_id);
    if (worker != workers_.end() && worker->second.cut_until_ms > now_ms_) continue;
    if (const auto* event = std::get_if<Event>(&message.body)) {
      ToCoordinator(message, *event);
    } else if (worker != workers_.end() && worker->second.hung_until_ms <= now_ms_) {
      ToWorker(worker->second, message);
    }
  }
}

// The shell's part: whoever is not known has to say Hello first. While it waits for its disk, messages wait; while the disk is full, they
// are thrown away.
void Simulation::ToCoordinator(const Message& message, const Event& event) {
  const std::string& worker_id = message.worker_id;
  if (busy_until_ms_ > now_ms_) {
    if (disk_state_ != Disk::kFull) network_.emplace(busy_until_ms_, message);
    return;
  }
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

// ---- Coordinator ------------------------------------------------------------------------------------------------------------------

void Simulation::Feed(const Event& event) {
  const std::vector<Effect> effects = scheduler_.Step(now_ms_, event);
  if (Fault("coordinator died before its log was written", 0.003)) {
    if (shell_fault_ == ShellFault::kSendsBeforeLog) {
      for (const DispatchEffect& dispatch : Only<DispatchEffect>(effects)) Post({dispatch.worker_id, Effect(dispatch)});
      for (const AckEffect& ack : Only<AckEffect>(effects)) Post({ack.worker_id, Effect(ack)});
      checker_.Step(now_ms_, event, effects);  // The world has seen them.
    }
    Restart();
    return;
  }
  unseen_ = {now_ms_, event, effects};
  for (const Effect& effect : effects) {
    if (const auto* append = std::get_if<AppendEffect>(&effect)) unlogged_.push_back(append->event);
    if (const auto* dispatch = std::get_if<DispatchEffect>(&effect)) unsent_.push_back({dispatch->worker_id, effect});
    if (const auto* ack = std::get_if<AckEffect>(&effect)) unsent_.push_back({ack->worker_id, effect});
    if (const auto* cancel = std::get_if<CancelTaskEffect>(&effect)) unsent_.push_back({cancel->worker_id, effect});
    if (const auto* drain = std::get_if<DrainWorkerEffect>(&effect)) unsent_.push_back({drain->worker_id, effect});
  }
  disk_state_ = Disk::kFine;
  if (!unlogged_.empty() && Fault("disk slow", 0.01)) {
    disk_state_ = Disk::kSlow;
    busy_until_ms_ = now_ms_ + Between(50, 1'500);
  } else if (!unlogged_.empty() && Fault("disk full", 0.003)) {
    disk_state_ = Disk::kFull;
    busy_until_ms_ = now_ms_ + Between(1'000, 6'000);
  } else {
    Flush();
  }
}

// What is not durable has not happened, as far as anybody can tell.
void Simulation::Show() {
  if (!unseen_) return;
  checker_.SetDoneSorties(DoneSorties());
  checker_.Step(unseen_->now_ms, unseen_->event, unseen_->effects);
  unseen_.reset();
  for (const std::string& violation : checker_.TakeViolations()) Complain(violation);
}

// The log is durable; only now may messages leave.
void Simulation::Flush() {
  Show();
  disk_.insert(disk_.end(), unlogged_.begin(), unlogged_.end());
  if (!unlogged_.empty()) tail_ = unlogged_.size();
  unlogged_.clear();
  for (const Message& message : std::exchange(unsent_, {})) {
    if (Fault("coordinator died while it sent", 0.01)) {
      Restart();
      return;
    }
    Post(message);
  }
}

void Simulation::Restart() {
  if (shell_fault_ == ShellFault::kLosesTail) disk_.resize(disk_.size() - std::exchange(tail_, 0));
  unlogged_.clear();
  unsent_.clear();
  unseen_.reset();
  busy_until_ms_ = 0;
  scheduler_ = Scheduler(options_);
  for (const v1::LogEvent& event : disk_) {
    const trem::Status status = scheduler_.Restore(event);
    if (!status.ok()) Complain("the log cannot be replayed: " + status.ToString());
  }
  for (const std::string& job_id : removed_) {
    if (scheduler_.FindSortie(job_id) != nullptr) Complain("a removed job is there again");
  }
  last_heard_ms_.clear();
  checker_.Restart();
  checker_.CheckLog(disk_);
  for (const std::string& violation : checker_.TakeViolations()) Complain(violation);
}

void Simulation::DisturbCoordinator() {
  if (busy_until_ms_ > now_ms_) {
    if (unseen_ && Fault("coordinator died while it wrote its log", 0.02)) {
      if (Chance(0.5)) {
        disk_.insert(disk_.end(), unlogged_.begin(), unlogged_.end());
        Show();
      }
      Restart();
    }
    return;
  }
  // Messages wait meanwhile, and its clock has jumped when it goes on.
  if (Fault("coordinator stopped", 0.001)) {
    disk_state_ = Disk::kSlow;
    busy_until_ms_ = now_ms_ + Between(500, 20'000);
  } else if (Fault("log compacted", 0.003)) {
    disk_ = scheduler_.Snapshot();
    tail_ = 0;
  }
}

void Simulation::CoordinatorTick() {
  if (busy_until_ms_ > now_ms_) return;
  std::vector<std::string> lost;
  for (const auto& [worker_id, heard_ms] : last_heard_ms_) {
    if (now_ms_ - heard_ms > kSilenceMs) lost.push_back(worker_id);
  }
  for (const std::string& worker_id : lost) {
    if (busy_until_ms_ > now_ms_) return;
    last_heard_ms_.erase(worker_id);
    Feed(WorkerLostEvent{worker_id});
  }
  if (busy_until_ms_ > now_ms_) return;
  Feed(TickEvent{});
  // Heartbeats to those it knows.
  for (auto& [id, worker] : workers_) {
    if (last_heard_ms_.count(id) == 0 || worker.hung_until_ms > now_ms_ || worker.cut_until_ms > now_ms_) continue;
    if (!Fault("message lost", 0.05)) worker.heard_ms = now_ms_;
  }
}

// The client's part: it asks until it sees its job.
void Simulation::Submit(const std::string& job_id) {
  if (busy_until_ms_ > now_ms_ || scheduler_.FindSortie(job_id) != nullptr || removed_.count(job_id) > 0) return;
  Feed(SubmitJobEvent{job_id, FakeSortie(submitted_.at(job_id)), job_id, static_cast<int>((seed_ + comes_back_) % 3) - 1});
}

// The client asks until it is told that the job is gone; it may then begin anew.
void Simulation::RemoveJobs() {
  if (busy_until_ms_ > now_ms_ || submitted_.count(to_remove_) == 0) return;
  if (removed_.count(to_remove_) > 0) {
    if (comes_back_ || !Fault("job submitted again", 0.01)) return;
    comes_back_ = true;
    removed_.erase(to_remove_);
    cancelled_.erase(to_remove_);
    return;
  }
  const auto status = scheduler_.JobStatus(to_remove_);
  if (comes_back_ || !status || status->state() == v1::JOB_RUNNING || !Fault("job removed", 0.02)) return;
  Feed(RemoveJobEvent{to_remove_});
  if (busy_until_ms_ <= now_ms_ && scheduler_.FindSortie(to_remove_) == nullptr) removed_.insert(to_remove_);
}

std::set<std::string> Simulation::DoneSorties() const {
  std::set<std::string> sorties;
  for (const auto& [job_id, name] : submitted_) {
    const auto status = scheduler_.JobStatus(job_id);
    if (status.has_value() && status->state() == v1::JOB_DONE) sorties.insert(name);
  }
  return sorties;
}

// ---- The world --------------------------------------------------------------------------------------------------------------------

void Simulation::Disturb() {
  DisturbCoordinator();
  DisturbWorkers();
  if (!stored_.empty() && Fault("artefact damaged", 0.005))
    damaged_.insert(stored_[rng_.UniformIndex(static_cast<std::uint32_t>(stored_.size()))]);
}

// Once faults have stopped: whoever sees holes mends what made them and has the job tried again.
void Simulation::RetryWhatEndedInPart() {
  for (const auto& [job_id, name] : submitted_) {
    const auto status = scheduler_.JobStatus(job_id);
    if (!status.has_value() || status->state() != v1::JOB_DONE_IN_PART) continue;
    if (name != poisoned_sortie_) return Complain("job " + job_id + " has a hole that nothing made");
    if (status->holes_size() != 1 || status->holes(0).subject() != "ENHANCE window 1") Complain("job " + job_id + " has other holes");
    ++faults_.counts["job ended in part"];
    is_healed_ = true;
    Feed(RetryJobEvent{job_id});
    return;
  }
}

bool Simulation::AllJobsEnded() const {
  return std::all_of(submitted_.begin(), submitted_.end(), [this](const auto& job) {
    if (removed_.count(job.first) > 0) return true;
    const auto status = scheduler_.JobStatus(job.first);
    return status.has_value() && status->state() != v1::JOB_RUNNING && status->state() != v1::JOB_DONE_IN_PART;
  });
}

void Simulation::CheckOutputs() {
  for (const auto& [job_id, sortie_name] : submitted_) {
    if (removed_.count(job_id) > 0) {
      if (scheduler_.FindSortie(job_id) != nullptr) Complain("a removed job is there again");
      continue;
    }
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
  if (Chance(0.2)) poisoned_sortie_ = "leg";
  if (Chance(0.4)) to_remove_ = Chance(0.5) ? "a" : "b";
  for (;; now_ms_ += kStepMs) {
    faults_on_ = now_ms_ < faults_end_ms;
    if (busy_until_ms_ <= now_ms_ && unseen_) Flush();  // The disk has done its work.
    if (workers_.size() < 3 && (!faults_on_ || Chance(0.05))) AddWorker();
    for (const auto& [job_id, name] : submitted_) Submit(job_id);
    if (busy_until_ms_ <= now_ms_ && submitted_.count(to_cancel) > 0 && Fault("job cancelled", 0.002)) {
      Feed(CancelJobEvent{to_cancel});
      // When the coordinator dies before it is written down, the client sees a running job and may leave it so.
      cancelled_.insert(to_cancel);
    }
    RemoveJobs();
    DeliverDue();
    std::vector<std::string> left;
    for (auto& [id, worker] : workers_) {
      RunWorker(worker);
      if (!worker.is_draining || !worker.work.empty() || !worker.results.empty()) continue;
      Post({id, Event(WorkerGoodbyeEvent{id})});
      left.push_back(id);
    }
    for (const std::string& id : left) workers_.erase(id);
    if (faults_on_) {
      Disturb();
    } else if (busy_until_ms_ <= now_ms_) {
      RetryWhatEndedInPart();
    }
    CoordinatorTick();
    const bool is_waited_for = faults_on_ && submitted_.count(to_remove_) > 0 && !comes_back_;
    if (AllJobsEnded() && busy_until_ms_ <= now_ms_ && !is_waited_for) break;
    if (now_ms_ > peace_end_ms) {
      Complain("the jobs do not end although the faults have");
      return violations_;
    }
    if (violations_.size() > 20) return violations_;
  }
  CheckOutputs();
  return violations_;
}

}  // namespace trem::testing
