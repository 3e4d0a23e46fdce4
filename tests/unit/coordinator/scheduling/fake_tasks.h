#pragma once

#include <string>
#include <vector>

#include "coordinator/scheduling/scheduler.h"

namespace trem::testing {

// How many windows and tiles the fake tasks below make of a job: 2 ranges of frames x 2 ROIs, and 3 tiles.
inline constexpr std::uint32_t kFakeWindowCount = 4;
inline constexpr std::uint32_t kFakeTileCount = 3;
inline constexpr std::uint32_t kFakeTaskCount = 1 + kFakeWindowCount + 1 + kFakeTileCount + 1;

// A complete sortie whose name tells it from others; the same name is the same sortie.
v1::Sortie FakeSortie(const std::string& name);
// The name of the fake sortie that a task is of, by its source: ENHANCE tasks do not carry the name, so that sorties may share them.
std::string FakeSortieNameOf(const v1::TaskSpec& task);

// What a worker would make of a task: outputs are digests of the task's key, so the same key gives the same result. INGEST sees content
// `source_content` in the source: equal contents have equal manifests.
v1::TaskResult FakeResult(const v1::TaskSpec& spec, const std::string& source_content = "source");

// The last effects of one kind, in order.
template <typename T>
std::vector<T> Only(const std::vector<Effect>& effects) {
  std::vector<T> chosen;
  for (const Effect& effect : effects) {
    if (const T* e = std::get_if<T>(&effect)) chosen.push_back(*e);
  }
  return chosen;
}

// A scheduler with a clock that stands still unless moved, and a record of everything it wanted to be durable.
class Bench {
 public:
  explicit Bench(const SchedulerOptions& scheduler_options = {}) : options(scheduler_options), scheduler(scheduler_options) {}

  std::vector<Effect> Step(const Event& event);
  // Advances the clock, then a Tick.
  std::vector<Effect> Wait(TimeMs ms);
  std::vector<Effect> Hello(const std::string& worker_id, std::vector<Attempt> running = {}, std::uint32_t credit = 1,
                            std::uint64_t memory_bytes_max = 0, const std::string& host = "");
  std::vector<Effect> Submit(const std::string& job_id, const std::string& sortie_name = "leg", const std::string& user = "",
                             int priority = 0);
  std::vector<Effect> Done(const DispatchEffect& dispatch);
  std::vector<Effect> Fail(const DispatchEffect& dispatch, StatusCode code, const std::string& message,
                           const std::vector<std::string>& bad_artefacts = {});
  // Reports failures of this code, and waits in between, until the task is no longer handed out; returns how often it was.
  int FailUntilGivenUp(DispatchEffect dispatch, StatusCode code, const std::string& message);
  std::vector<Effect> Progress(const DispatchEffect& dispatch, double fraction = 0.5);
  // Does every task that is dispatched, at once, until nothing is left to do; returns them in order.
  std::vector<DispatchEffect> RunAll(std::vector<Effect> effects);
  // A new scheduler from the log: the coordinator was killed and started again. `forget`: task keys whose artefacts are gone.
  void Restart(const std::vector<std::string>& forget = {});
  // The same after the log was replaced by the scheduler's snapshot.
  void RestartFromSnapshot();
  v1::JobStatus Status(const std::string& job_id) const { return *scheduler.JobStatus(job_id); }

  SchedulerOptions options;
  Scheduler scheduler;
  TimeMs now_ms = 1'000;
  std::vector<v1::LogEvent> log;
};

// "INGEST", "ENHANCE window 2": what a dispatch is about.
std::string TitleOf(const DispatchEffect& dispatch);
Attempt AttemptOf(const DispatchEffect& dispatch);

}  // namespace trem::testing
