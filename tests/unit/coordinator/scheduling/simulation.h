#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <variant>
#include <vector>

#include "coordinator/scheduling/scheduler.h"
#include "mosaic/base/rng.h"
#include "tests/unit/coordinator/scheduling/fake_tasks.h"

namespace trem::testing {

// How often each fault happened, so that a test can tell that it saw all of them.
struct FaultCounts {
  std::map<std::string, std::uint64_t> counts;
};

// One seeded world: a scheduler, its log on "disk", workers, and a network between them, under a virtual clock.
//
// While faults are on, messages are lost, doubled, delayed and overtaken; workers crash, hang, come back, answer late or twice, fail,
// leave; tasks need several tries; the coordinator dies before or after its log is written and with any part of its messages sent. Then
// the faults stop, and the jobs must end. Violations of safety are collected as text; the world goes on.
class Simulation {
 public:
  explicit Simulation(std::uint64_t seed);

  // Runs faults, then peace. Returns the violations: empty means that every promise was kept.
  std::vector<std::string> Run();
  const FaultCounts& faults() const { return faults_; }

 private:
  struct Work {
    v1::TaskSpec task;
    std::uint32_t attempt = 0;
    TimeMs ends_ms = 0;
    bool cancelled = false;
  };
  struct Result {
    TaskDoneEvent event;
    TimeMs resend_ms = 0;
  };
  struct SimWorker {
    std::string id;
    bool welcome = false;
    TimeMs hello_ms = 0;
    TimeMs heard_ms = 0;  // When the coordinator was last heard.
    TimeMs hung_until_ms = 0;
    TimeMs next_progress_ms = 0;
    std::deque<Work> work;        // The first one is being computed.
    std::vector<Result> results;  // Until acknowledged.
  };
  // To the coordinator (an Event) or to a worker (an Effect, or a Welcome).
  struct Welcome {};
  struct SayHello {};
  struct Message {
    std::string worker_id;
    std::variant<Event, Effect, Welcome, SayHello> body;
  };

  bool Chance(double probability);
  bool Fault(const char* name, double probability);
  TimeMs Between(TimeMs low, TimeMs high);
  void Complain(const std::string& text);

  void Post(Message message);
  void PostHello(SimWorker& worker);
  void DeliverDue();
  void ToCoordinator(const std::string& worker_id, const Event& event);
  void ToWorker(SimWorker& worker, const Message& message);
  void OnDispatch(SimWorker& worker, const DispatchEffect& dispatch);
  void OnCancel(SimWorker& worker, const CancelTaskEffect& cancel);
  void RunWorker(SimWorker& worker);
  void FinishWork(SimWorker& worker);
  void DisturbWorkers();
  void AddWorker();

  void Submit(const std::string& job_id);
  void Feed(const Event& event);
  void NoteEndsOfLeases(const Event& event);
  void CheckEffect(const Effect& effect);
  void Restart();
  void CoordinatorTick();
  bool AllJobsEnded() const;
  void CheckOutputs();

  std::uint64_t seed_;
  Rng rng_;
  SchedulerOptions options_;
  Scheduler scheduler_;
  TimeMs now_ms_ = 1'000;
  bool faults_on_ = true;
  FaultCounts faults_;
  std::vector<std::string> violations_;

  std::vector<v1::LogEvent> disk_;
  std::map<std::string, std::string> submitted_;  // Job -> name of its sortie.
  std::set<std::string> cancelled_;
  std::map<std::string, SimWorker> workers_;
  std::uint32_t worker_count_ = 0;
  std::multimap<TimeMs, Message> network_;
  std::map<std::string, TimeMs> last_heard_ms_;  // The shell's: worker -> when. Absent: not known to the coordinator.

  // What the checks know.
  std::map<std::string, std::uint32_t> newest_dispatch_;               // Key -> attempt, over all lives of the coordinator.
  std::map<std::string, std::pair<std::string, std::uint32_t>> live_;  // Key -> holder, attempt: in this life of the coordinator.
  std::set<std::string> committed_;
};

}  // namespace trem::testing
