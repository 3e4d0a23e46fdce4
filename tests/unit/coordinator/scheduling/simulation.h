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
#include "tests/unit/coordinator/scheduling/checker.h"
#include "tests/unit/coordinator/scheduling/fake_tasks.h"

namespace trem::testing {

// How often each fault happened, so that a test can tell that it saw all of them.
struct FaultCounts {
  std::map<std::string, std::uint64_t> counts;
};

// A fault of the simulated shell: what stands between the scheduler, its log and the network.
enum class ShellFault {
  kNone,
  kSendsBeforeLog,  // Messages leave before the log is durable.
  kLosesTail,       // A crash loses what the log had reported as durable.
};

// One seeded world: a scheduler, its log on "disk", workers, an artefact store and a network between them, under a virtual clock.
//
// While faults are on, messages are lost, doubled, delayed and overtaken; links are cut; workers crash, hang, come back, answer late or
// twice, fail, leave, are drained; jobs are cancelled, removed and submitted again under the same name; tasks need several tries, one of
// them more than there are; stored artefacts are damaged; the disk is slow or full; the log is compacted; the coordinator is stopped for a
// while, and dies before or after its log is written and with any part of its messages sent. Then the faults stop, and the jobs must end.
// Violations of safety are collected as text; the world goes on.
class Simulation {
 public:
  explicit Simulation(std::uint64_t seed, ShellFault shell_fault = ShellFault::kNone);

  // Runs faults, then peace. Returns the violations: empty means that every promise was kept.
  std::vector<std::string> Run();
  const FaultCounts& faults() const { return faults_; }

 private:
  struct Work {
    v1::TaskSpec task;
    std::uint32_t attempt = 0;
    TimeMs ends_ms = 0;
    bool is_cancelled = false;
  };
  struct Result {
    TaskDoneEvent event;
    TimeMs resend_ms = 0;
  };
  struct SimWorker {
    std::string id;
    std::string host;
    std::uint32_t credit = 1;
    std::uint64_t memory_bytes_max = 0;
    bool is_welcome = false;
    bool is_draining = false;
    TimeMs hello_ms = 0;
    TimeMs heard_ms = 0;  // When the coordinator was last heard.
    TimeMs hung_until_ms = 0;
    TimeMs cut_until_ms = 0;  // No message passes, either way.
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
  enum class Disk { kFine, kSlow, kFull };

  bool Chance(double probability);
  bool Fault(const char* name, double probability);
  TimeMs Between(TimeMs low, TimeMs high);
  void Complain(const std::string& text);

  void Post(Message message);
  void DeliverDue();
  void ToCoordinator(const Message& message, const Event& event);

  // Workers (simulation_workers.cc).
  void AddWorker();
  void PostHello(SimWorker& worker);
  void ToWorker(SimWorker& worker, const Message& message);
  void OnDispatch(SimWorker& worker, const DispatchEffect& dispatch);
  void OnCancel(SimWorker& worker, const CancelTaskEffect& cancel);
  void RunWorker(SimWorker& worker);
  void FinishWork(SimWorker& worker);
  void DisturbWorkers();
  bool IsPoisoned(const v1::TaskSpec& task) const;

  void Submit(const std::string& job_id);
  void Feed(const Event& event);
  void Flush();
  void Show();
  void Restart();
  void CoordinatorTick();
  void DisturbCoordinator();
  void Disturb();
  void RetryWhatEndedInPart();
  void RemoveJobs();
  std::set<std::string> DoneSorties() const;
  bool AllJobsEnded() const;
  void CheckOutputs();

  std::uint64_t seed_;
  ShellFault shell_fault_;
  Rng rng_;
  SchedulerOptions options_;
  Scheduler scheduler_;
  Checker checker_;
  TimeMs now_ms_ = 1'000;
  bool faults_on_ = true;
  FaultCounts faults_;
  std::vector<std::string> violations_;

  std::vector<v1::LogEvent> disk_;
  std::size_t tail_ = 0;  // Events that the last write added.
  std::vector<v1::LogEvent> unlogged_;
  std::vector<Message> unsent_;
  struct SeenStep {
    TimeMs now_ms = 0;
    Event event;
    std::vector<Effect> effects;
  };
  std::optional<SeenStep> unseen_;  // The step whose log is not durable yet.
  Disk disk_state_ = Disk::kFine;
  TimeMs busy_until_ms_ = 0;                     // The coordinator waits for its disk, or is stopped.
  std::map<std::string, TimeMs> last_heard_ms_;  // The shell's: worker -> when. Absent: not known to the coordinator.

  std::map<std::string, std::string> submitted_;  // Job -> name of its sortie.
  std::set<std::string> cancelled_;
  std::string to_remove_;          // Its client lets go of it when it has ended.
  std::set<std::string> removed_;  // As their clients were told.
  bool comes_back_ = false;        // The client of a removed job submits it again.
  std::string poisoned_sortie_;    // One window of it always fails, until it is healed.
  bool is_healed_ = false;
  std::map<std::string, SimWorker> workers_;
  std::uint32_t worker_count_ = 0;
  std::multimap<TimeMs, Message> network_;
  std::vector<std::string> stored_;  // Digests of all results so far.
  std::set<std::string> damaged_;
};

}  // namespace trem::testing
