#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "coordinator/scheduling/scheduler.h"

namespace trem::testing {

// Watches what goes into a scheduler and what comes out of it, over all lives of the coordinator, and knows what must never happen. Its own
// record of leases is kept by the rules of Scheduler's comment, not by its code.
class Checker {
 public:
  explicit Checker(const SchedulerOptions& options) : options_(options) {}

  // Call with every step. The effects of a step that was never made durable are not shown.
  void Step(TimeMs now_ms, const Event& event, const std::vector<Effect>& effects);
  // Sorties that some job has which is done: what was computed for them must not be forgotten. Call before the step of which it is true.
  void SetDoneSorties(std::set<std::string> sorties) { done_sorties_ = std::move(sorties); }
  // The coordinator has died and started again.
  void Restart();
  // The log is all that the next life knows: what was acknowledged has to be in it.
  void CheckLog(const std::vector<v1::LogEvent>& log);
  // How often a worker that had the lease has reported a failure of the task.
  std::uint32_t FailuresOf(const std::string& key) const;
  std::vector<std::string> TakeViolations() { return std::exchange(violations_, {}); }

 private:
  struct Holder {
    std::string worker_id;
    TimeMs until_ms = 0;
  };
  struct WorkerRecord {
    std::uint32_t credit = 0;
    std::uint64_t memory_bytes_max = 0;
    bool is_draining = false;
    std::map<std::string, std::uint64_t> held;  // Task key -> memory, until the worker has reported it done or was silent for a lease.
    std::map<std::string, TimeMs> held_until_ms;
  };

  void TakeEvent(const Event& event);
  void TakeEffect(const Effect& effect);
  void OnDispatch(const DispatchEffect& dispatch);
  void OnAppend(const v1::LogEvent& event);
  void CheckLeases();
  void CheckUserLimit(const std::string& sortie);
  void ForgetUnused();
  void Complain(const std::string& text) { violations_.push_back(text); }

  SchedulerOptions options_;
  TimeMs now_ms_ = 0;
  std::vector<std::string> violations_;
  std::map<std::string, std::uint32_t> newest_;  // Key -> highest number handed out, ever.
  // Key -> number that somebody may hold since before the restart, who has not come back yet; until it is handed out anew.
  std::map<std::string, std::uint32_t> restored_;
  std::map<std::string, std::map<std::uint32_t, Holder>> live_;  // Key -> attempt -> holder, in this life.
  std::set<std::string> committed_;
  std::set<std::pair<std::string, std::uint32_t>> hedges_;  // Written down as second attempts.
  std::map<std::string, std::uint32_t> failures_;           // Key -> ever.
  std::map<std::string, WorkerRecord> workers_;             // In this life.
  const TaskDoneEvent* done_ = nullptr;                     // The event of this step, when it is one.
  bool done_was_due_ = false;                               // Its result had to be taken.
  bool done_was_committed_ = false;
  std::map<std::string, std::string> sortie_of_;           // Key -> name of the sortie that it was handed out for.
  std::set<std::string> ingests_;                          // Keys that no two jobs share: every job looks at its source anew.
  std::map<std::string, std::set<std::string>> users_of_;  // Sortie -> who has ever submitted it.
  std::set<std::string> done_sorties_;
  std::set<std::string> forgotten_;     // Keys whose results went with a removed job, perhaps.
  std::set<std::string> acknowledged_;  // Keys whose committed result a worker was told to forget.
};

}  // namespace trem::testing
