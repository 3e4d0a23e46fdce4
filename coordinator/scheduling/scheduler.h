#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "coordinator/scheduling/events.h"
#include "coordinator/scheduling/job_graph.h"
#include "mosaic/base/status.h"
#include "proto/trem/v1/fleet.pb.h"

namespace trem {

struct SchedulerOptions {
  // A lease ends this long after the dispatch or the last Progress. Shorter: a hung task is noticed sooner, but a task that reports
  // seldom loses its lease while it works.
  std::uint32_t lease_ms = 20'000;
  // A task that reports kUnavailable, kExhausted or kCorrupt this often fails its jobs.
  std::uint32_t failures_max = 3;
  // A task whose lease was lost this often (worker gone, hung, or message lost) fails its jobs: it may be what kills the workers.
  std::uint32_t losses_max = 5;
  // Before the second attempt after a failure; doubles with every further one. Gives a mount or a full disk time to recover.
  std::uint32_t retry_delay_ms = 1'000;
  // After a restart, how long a task that was handed out before waits for its worker to come back and name it.
  std::uint32_t restart_grace_ms = 3'000;
};

// The coordinator's brain: a state machine without clock, socket, disk or random source. Same events, same effects.
//
// Rules:
//  - Jobs in the order they were submitted, tasks of a job in plan order; a task goes to the worker with the fewest tasks (ties: by id)
//    among those with credit left and a memory limit that holds it.
//  - Every hand-out has a number that rises per task key, across restarts too. Only Progress of exactly the newest attempt renews the
//    lease; only the newest attempt's result is taken (the fence). Every Done is acknowledged, so that the worker can forget it.
//  - A revoked attempt keeps its worker's slot until the worker reports it done, or is silent about it for a lease: a worker that hangs
//    gets nothing new.
//  - The first result of a key is committed. A later one with the same outputs is nothing; with others it is a note to all its jobs.
//  - Jobs that share a key share the task and its result.
//
// Cost of a step: O(log n) plus the dispatches it makes; amortised over a stage's tasks when one is unfolded. Workers whose memory limit
// holds none of the ready tasks cost O(1) each at every step that dispatches.
class Scheduler {
 public:
  explicit Scheduler(const SchedulerOptions& options = {}) : options_(options) {}

  // Rebuilds the state: call with every event of the log, oldest first, before the first Step. kCorrupt when an event makes no sense
  // where it stands. A TaskCommitted may be left out when its artefacts are gone: the task then runs again.
  Status Restore(const v1::LogEvent& event);

  // The only mutator from then on. `now_ms` never goes backwards (checked).
  std::vector<Effect> Step(TimeMs now_ms, const Event& event);

  // Nullopt: no such job.
  std::optional<v1::JobStatus> JobStatus(const std::string& job_id) const;
  // All jobs, in the order they were submitted.
  std::vector<v1::JobStatus> JobStatuses() const;
  // By worker id; last_seen_ms_ago is the shell's to fill in.
  std::vector<v1::WorkerStatus> WorkerStatuses() const;
  // The sortie a job was submitted with; null: no such job.
  const v1::Sortie* FindSortie(const std::string& job_id) const;
  // Committed results: key -> result.
  const v1::TaskResult* FindResult(const std::string& task_key) const;
  // Whether any attempt is out with a worker and leased.
  bool has_running() const { return !leases_.empty(); }

 private:
  using JobNumber = std::uint64_t;  // Order of submission.
  using JobPlace = std::pair<JobNumber, TaskPlace>;

  struct Job {
    std::string id;
    v1::JobState state = v1::JOB_RUNNING;
    Status error;
    std::unique_ptr<JobGraph> graph;
  };
  enum class TaskState { kReady, kDelayed, kLeased };
  // A known, unfinished task that at least one running job wants.
  struct Task {
    std::uint64_t memory_bytes = 0;
    std::set<JobPlace> wanted_by;
    TaskState state = TaskState::kReady;
    TimeMs until_ms = 0;    // kDelayed: ready then. kLeased: the lease's end.
    std::string worker_id;  // kLeased. Empty: whoever held it before a restart.
    double fraction = 0.0;
    std::uint32_t failures = 0;
    std::uint32_t losses = 0;
  };
  struct Slot {
    std::uint32_t attempt = 0;
    bool live = true;          // False: revoked; the worker has been told so.
    TimeMs held_until_ms = 0;  // When not live: the slot is free then.
  };
  struct Worker {
    std::string host;
    std::uint32_t pid = 0;
    std::uint32_t credit = 1;
    std::uint64_t memory_bytes_max = 0;
    std::map<std::string, Slot> slots;  // Task key -> what the worker has of it.
  };
  struct Finished {
    FinishedTask task;
    std::set<JobNumber> used_by;
  };
  using TaskMap = std::map<std::string, Task>;
  using WorkerMap = std::map<std::string, Worker>;

  void On(const SubmitJobEvent& event);
  void On(const CancelJobEvent& event);
  void On(const WorkerHelloEvent& event);
  void On(const WorkerLostEvent& event);
  void On(const WorkerGoodbyeEvent& event);
  void On(const ProgressEvent& event);
  void On(const TaskDoneEvent& event);
  void On(const TickEvent& event);

  // Jobs (scheduler_jobs.cc).
  void StartJob(const std::string& job_id, const v1::Sortie& sortie);
  void Want(JobNumber number, const PlannedTask& planned, std::vector<std::pair<JobPlace, std::string>>* finished_already);
  void Commit(const std::string& key, FinishedTask finished);
  void Deliver(std::vector<std::pair<JobPlace, std::string>> completions);
  void EndJob(JobNumber number, v1::JobState state, const Status& error);
  void FailJobsOf(const std::string& key, StatusCode code, const std::string& message);
  void CompareWithCommitted(const Attempt& attempt, const v1::TaskResult& result);
  std::string TitleOf(const Task& task) const;
  v1::JobStatus StatusOf(JobNumber number) const;

  // Leases, workers, queues (scheduler.cc).
  void Enqueue(const std::string& key, Task& task);
  void Unqueue(const std::string& key, const Task& task);
  void Delay(const std::string& key, Task& task);
  void Lease(const std::string& key, Task& task, const std::string& worker_id, std::uint32_t lease_ms);
  void Renew(const std::string& key, Task& task);
  void Adopt(const std::string& key, Task& task, const std::string& worker_id);
  void LeaveQueues(const std::string& key, Task& task);
  void Lose(const std::string& key, bool counts, const std::string& reason);
  void Revoke(const std::string& worker_id, const Attempt& attempt, const std::string& reason);
  void TakeBackAll(const std::string& worker_id, bool counts, const std::string& reason);
  void SetSlot(const std::string& worker_id, const std::string& key, const Slot& slot);
  void FreeSlot(const std::string& worker_id, const std::string& key);
  void TakeResult(const TaskDoneEvent& event);
  void OnFailure(const std::string& key, Task& task, const TaskDoneEvent& event);
  void BeginAfterRestore();
  void DispatchReady();
  void DispatchTo(const std::string& worker_id, const std::string& key);
  const std::string* BestReadyFor(const Worker& worker) const;
  void Append(v1::LogEvent event) { effects_.push_back(AppendEffect{std::move(event)}); }

  SchedulerOptions options_;
  TimeMs now_ms_ = 0;
  bool restoring_ = true;
  std::vector<Effect> effects_;

  std::map<JobNumber, Job> jobs_;
  std::map<std::string, JobNumber> job_numbers_;
  TaskMap tasks_;
  std::map<std::string, Finished> finished_;
  std::map<std::string, std::uint32_t> newest_attempts_;  // Key -> number of the newest hand-out ever.
  std::set<std::string> handed_out_before_;               // Keys handed out and not committed when the log ends.
  WorkerMap workers_;

  // Indices over the above.
  std::map<std::uint64_t, std::set<std::pair<JobPlace, std::string>>> ready_;  // Memory -> tasks in order of work.
  std::set<std::pair<TimeMs, std::string>> delayed_;                           // Ready at -> key.
  std::set<std::pair<TimeMs, std::string>> leases_;                            // End -> key.
  std::set<std::tuple<TimeMs, std::string, std::string>> revoked_;             // Slot's end, worker, key.
  std::set<std::pair<std::size_t, std::string>> idle_;                         // Slots in use -> workers with credit left.
};

}  // namespace trem
