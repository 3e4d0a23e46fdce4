#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <tuple>
#include <unordered_map>
#include <utility>
#include <vector>

#include "coordinator/scheduling/events.h"
#include "coordinator/scheduling/job_graph.h"
#include "coordinator/scheduling/planted_fault.h"
#include "coordinator/scheduling/ready_queue.h"
#include "coordinator/scheduling/scheduler_options.h"
#include "mosaic/base/status.h"
#include "proto/trem/v1/fleet.pb.h"

namespace trem {

// The coordinator's brain: a state machine without clock, socket, disk or random source. Same events, same effects.
//
// Rules:
//  - Jobs of a higher priority first; among those, the user with the fewest running tasks; of a user, jobs in the order they were
//    submitted and tasks in plan order. A task goes to the idle worker whose free memory holds it most tightly (ties: fewest tasks, id). A
//    host goes on with tasks that read what its last ones read, and begins where no other host is.
//  - Every hand-out has a number that rises per task key, across restarts too. Only Progress of a leased attempt renews its lease; only
//    the result of a leased or the newest attempt is taken (the fence). Every Done is acknowledged, so that the worker can forget it.
//  - A task has one leased attempt; near the end of a stage a straggler gets a second one beside it. The first result ends the other.
//  - A revoked attempt keeps its worker's slot until the worker reports it done, or is silent about it for a lease: a worker that hangs
//    gets nothing new.
//  - A worker that has nothing to do lends its processor to what runs on its host: every attempt there is told how many it may use.
//  - The first result of a key is committed. A later one with the same outputs is nothing; with others it is a note to all its jobs.
//  - A failed task is tried again after a delay that grows, on another worker when there is one; SchedulerOptions says how often. Then it
//    is given up: a window or tile becomes a hole of its jobs, anything else fails them. kInvalidInput is never tried again.
//  - A task that failed because an input artefact is damaged waits until the task that made it has made it again.
//  - Jobs that share a key share the task and its result.
//
// Cost of a step: O(log n) plus the dispatches it makes, of O(log n) each and O(u) for u users whose tasks fit no idle worker; amortised
// over a stage's tasks when one is unfolded or a job ends.
class Scheduler {
 public:
  explicit Scheduler(const SchedulerOptions& options = {}) : options_(options) {}

  // Rebuilds the state: call with every event of the log, oldest first, before the first Step. kCorrupt when an event makes no sense
  // where it stands. A TaskCommitted may be left out when its artefacts are gone: the task then runs again.
  Status Restore(const v1::LogEvent& event);
  // The shortest log that Restore rebuilds the present state from: no attempt but the newest, no failed try, no repeated submission.
  std::vector<v1::LogEvent> Snapshot() const;
  // The same, one event a call, until nullopt: for those who have no time for all of them at once. Of the state as it is now, whatever
  // happens later; must not outlive the scheduler. Cost: O(jobs + tasks) with a small constant (about 40 bytes copied a task), then O(1) a
  // call.
  std::function<std::optional<v1::LogEvent>()> BeginSnapshot() const;

  // The only mutator from then on. `now_ms` never goes backwards (checked).
  std::vector<Effect> Step(TimeMs now_ms, const Event& event);

  // Nullopt: no such job.
  std::optional<v1::JobStatus> JobStatus(const std::string& job_id) const;
  // All jobs, in the order they were submitted.
  std::vector<v1::JobStatus> JobStatuses() const;
  // The jobs that share a task, and what it is called in each: "enhance 7". Empty: nobody wants or uses it.
  struct TaskUse {
    std::string job_id;
    std::string title;
  };
  std::vector<TaskUse> UsesOf(const std::string& task_key) const;
  // By worker id; last_seen_ms_ago is the shell's to fill in.
  std::vector<v1::WorkerStatus> WorkerStatuses() const;
  // The sortie a job was submitted with; null: no such job.
  const v1::Sortie* FindSortie(const std::string& job_id) const;
  // Calls `visit` on every artefact that some job has, and `visit_sortie` on what every job was submitted with.
  void VisitInUse(const std::function<void(const v1::ArtefactRef&)>& visit,
                  const std::function<void(const v1::Sortie&)>& visit_sortie) const;
  // How many jobs of this user are running.
  std::uint32_t RunningJobCount(const std::string& user) const;
  // Committed results: key -> result.
  const v1::TaskResult* FindResult(const std::string& task_key) const;
  // Whether any attempt is out with a worker and leased.
  bool has_running() const { return !lease_ends_.empty(); }
  // Leases that ended without a result since this object was made: no progress, the worker gone, or the task
  // handed back.
  std::uint64_t leases_lost() const { return leases_lost_; }

 private:
  using JobNumber = std::uint64_t;  // Order of submission.
  static constexpr TaskIndex kNoTask = ~TaskIndex{0};

  struct JobPlace {
    JobNumber job = 0;
    TaskPlace place;
    friend bool operator==(const JobPlace&, const JobPlace&) = default;
  };
  struct Job {
    std::string id;
    std::string user;
    int priority = 0;
    v1::JobState state = v1::JOB_RUNNING;
    Status error;
    std::unique_ptr<JobGraph> graph;
    std::array<std::vector<TaskIndex>, 5> tasks;           // By kind - 1 and index; every task that has become known.
    std::map<TaskPlace, TaskIndex> live;                   // Those that are leased.
    std::map<std::uint64_t, std::uint32_t> memory_wanted;  // Memory -> count, of its unfinished tasks.
  };
  struct Finished {
    v1::TaskKind kind = v1::TASK_KIND_UNSPECIFIED;
    std::shared_ptr<const FinishedTask> task;  // Shared with snapshots that are being written.
    std::vector<JobPlace> used_by;
  };
  // What went wrong with a task so far. Few tasks have any.
  struct Trouble {
    std::uint32_t failures = 0;
    std::uint32_t outages = 0;
    std::uint32_t losses = 0;
    std::uint32_t waits = 0;             // For inputs that are being made again, or for another worker.
    std::vector<std::string> failed_on;  // Workers, each once.
  };
  enum class TaskState : std::uint8_t { kIdle, kReady, kDelayed, kLeased, kFinished };
  // A key that was ever known. Idle: no running job wants it.
  struct Task {
    std::string key;
    std::vector<JobPlace> wanted_by;  // Most urgent first.
    std::unique_ptr<Finished> finished;
    std::unique_ptr<Finished> damaged;  // The result that is being made again.
    std::unique_ptr<Trouble> trouble;
    std::uint64_t memory_bytes = 0;
    TimeMs until_ms = 0;  // kDelayed: ready then.
    std::uint32_t newest_attempt = 0;
    std::uint32_t locality = 0;
    std::uint32_t repairs = 0;
    TaskState state = TaskState::kIdle;
    bool was_handed_out = false;  // While restoring: handed out and not finished.
  };
  struct Lease {
    std::uint32_t attempt = 0;
    std::string worker_id;  // Empty: whoever held it before a restart.
    std::string user;       // Whose share it uses.
    TimeMs until_ms = 0;
    TimeMs started_ms = 0;
    double fraction = 0.0;
  };
  struct Slot {
    std::uint32_t attempt = 0;
    bool live = true;          // False: revoked; the worker has been told so.
    TimeMs held_until_ms = 0;  // When not live: the slot is free then.
    std::uint64_t memory_bytes = 0;
    std::uint32_t processors = 1;  // What the worker was told.
  };
  struct Worker {
    std::string host;
    std::uint32_t pid = 0;
    std::uint32_t credit = 0;
    std::uint64_t memory_bytes_max = 0;
    bool is_draining = false;
    std::map<std::string, Slot> slots;  // Task key -> what the worker has of it.
  };
  struct Host {
    std::uint32_t worker_count = 0;
    ReadyKey last;            // What it was given last.
    std::uint32_t idle = 0;   // Slots of its workers that are free,
    std::uint32_t busy = 0;   // and that are not.
    std::uint32_t share = 1;  // Processors that each of its attempts may use.
    std::set<std::string> busy_workers;
  };
  struct User {
    std::uint32_t running = 0;
    std::uint64_t served = 0;          // Hand-outs so far.
    std::map<int, ReadyQueue> queues;  // By priority; none is empty.
  };
  // -priority, the user's running and served tasks, user.
  using QueueRank = std::tuple<int, std::uint32_t, std::uint64_t, std::string>;
  // Free memory, slots in use, worker.
  using IdleRank = std::tuple<std::uint64_t, std::size_t, std::string>;
  using Completions = std::vector<std::pair<JobPlace, TaskIndex>>;

  void On(const SubmitJobEvent& event);
  void On(const RetryJobEvent& event);
  void On(const CancelJobEvent& event);
  void On(const RemoveJobEvent& event);
  void On(const WorkerHelloEvent& event);
  void On(const WorkerLostEvent& event);
  void On(const WorkerGoodbyeEvent& event);
  void On(const DrainWorkerEvent& event);
  void On(const ProgressEvent& event);
  void On(const TaskDoneEvent& event);
  void On(const TickEvent& event);

  // Jobs and results (scheduler_jobs.cc).
  void AppendSubmitted(const std::string& job_id, const v1::Sortie& sortie, const std::string& user, int priority);
  void StartJob(const v1::JobSubmitted& submitted);
  void Want(JobNumber number, const PlannedTask& planned, Completions* finished_already);
  void StopWanting(TaskIndex index, const JobPlace& place);
  void Commit(TaskIndex index, v1::TaskKind kind, FinishedTask finished);
  void Deliver(Completions completions);
  void Unfold(JobNumber number, Result<std::vector<PlannedTask>> planned, Completions* completions);
  void EndJob(JobNumber number, v1::JobState state, const Status& error);
  void FailJob(JobNumber number, const Status& error);
  void ForgetJob(JobNumber number);
  void GiveUp(TaskIndex index, const Status& reason);
  void MakeHole(JobNumber number, const TaskPlace& place, const Status& reason);
  bool RepairInputs(TaskIndex index, const std::vector<std::string>& bad_artefacts);
  void Invalidate(TaskIndex index);
  void CompareResults(TaskIndex index, std::uint32_t attempt, const Finished& kept, const v1::TaskResult& result);

  // What is told about them (scheduler_status.cc).
  std::string TitleOf(const Task& task) const;
  v1::JobStatus StatusOf(JobNumber number) const;
  bool WaitsForMemory(const Job& job) const;
  void SnapshotJobs(std::vector<v1::LogEvent>* log) const;
  void FillRunning(const std::string& key, std::uint32_t attempt, v1::RunningTask* running) const;

  // Attempts: leases, slots, failures (scheduler_attempts.cc).
  void TakeBackAll(const std::string& worker_id, bool counts, const std::string& reason);
  void Lose(TaskIndex index, std::uint32_t attempt, bool counts, const std::string& reason);
  void Revoke(const std::string& worker_id, const Attempt& attempt, const std::string& reason);
  void TakeResult(const TaskDoneEvent& event);
  void OnFailure(TaskIndex index, const TaskDoneEvent& event);
  bool IsHopeless(const Trouble& trouble) const;
  Lease* FindLease(TaskIndex index, std::uint32_t attempt);
  void AddLease(TaskIndex index, Lease lease);
  void Renew(TaskIndex index, Lease* lease);
  void Adopt(TaskIndex index, std::uint32_t attempt, const std::string& worker_id);
  // Ends one lease; the worker's slot is held until it lets go. True: it was the task's last.
  bool EndLease(TaskIndex index, std::uint32_t attempt);
  // Takes the task out of whichever queue its state has it in and revokes its attempts, if any, for this reason.
  void LeaveQueues(TaskIndex index, const std::string& reason);
  void SetSlot(const std::string& worker_id, const std::string& key, const Slot& slot);
  void FreeSlot(const std::string& worker_id, const std::string& key);
  void BeginAfterRestore();

  // Queues and placement (scheduler_dispatch.cc).
  ReadyKey KeyOf(TaskIndex index) const;
  void Enqueue(TaskIndex index);
  void Unqueue(TaskIndex index);
  void Delay(TaskIndex index, std::uint64_t delay_ms);
  // Calls `change` on a user while its queues are out of the order in which they are served.
  template <typename Change>
  void ChangeUser(const std::string& name, Change change) {
    User& user = users_[name];
    LeaveOrder(name, user);
    change(user);
    EnterOrder(name, &user);
  }
  // Calls `change` on a worker while it is out of the idle ones.
  template <typename Change>
  void ChangeWorker(const std::string& worker_id, Change change) {
    Worker& worker = workers_.at(worker_id);
    idle_.erase({FreeMemory(worker), worker.slots.size(), worker_id});
    LeaveHost(worker_id, worker);
    change(worker);
    EnterHost(worker_id, worker);
    if (!worker.is_draining && worker.slots.size() < worker.credit + (TREM_PLANTED(kIgnoresCredit) ? 1 : 0))
      idle_.insert({FreeMemory(worker), worker.slots.size(), worker_id});
  }
  static std::uint64_t MemoryLimit(std::uint64_t memory_bytes_max) { return memory_bytes_max == 0 ? ~std::uint64_t{0} : memory_bytes_max; }
  // Takes what the worker has free and in use out of its host's sums, and puts it there again.
  void LeaveHost(const std::string& worker_id, const Worker& worker);
  void EnterHost(const std::string& worker_id, const Worker& worker);
  // Tells the attempts of hosts that have changed how many processors they may use.
  void ShareProcessors();
  static std::uint64_t FreeMemory(const Worker& worker);
  void LeaveOrder(const std::string& name, const User& user);
  void EnterOrder(const std::string& name, User* user);
  void DispatchReady();
  const ReadyKey* FirstReady(std::uint64_t memory_bytes_max, const ReadyQueue** queue) const;
  const std::string* PickWorker(TaskIndex index, bool* wait) const;
  ReadyKey NearestTo(const Worker& worker, const std::string& worker_id, const ReadyQueue& queue, const ReadyKey& first) const;
  void Dispatch(const std::string& worker_id, TaskIndex index, bool is_hedge);
  void HedgeStragglers();

  TaskIndex FindTask(const std::string& key) const;
  TaskIndex FindOrAddTask(const std::string& key);
  Trouble& TroubleOf(TaskIndex index);
  void Append(v1::LogEvent event) { effects_.push_back(AppendEffect{std::move(event)}); }

  SchedulerOptions options_;
  TimeMs now_ms_ = 0;
  bool restoring_ = true;
  std::uint64_t leases_lost_ = 0;
  std::vector<Effect> effects_;

  std::map<JobNumber, Job> jobs_;
  std::map<std::string, JobNumber> job_numbers_;
  JobNumber next_job_number_ = 0;
  std::deque<Task> tasks_;                                        // Grows only; addresses are stable.
  std::unordered_map<std::string_view, TaskIndex> task_indices_;  // Views of tasks_[i].key. Never iterated: its order is not defined.
  std::map<std::string, Worker> workers_;
  std::map<std::string, v1::LogEvent> differed_;  // Task key -> the report of a differing result.

  // Indices over the above.
  std::map<std::string, User> users_;
  std::set<QueueRank> ready_users_;                                    // Whose queues may be served, in that order.
  std::set<std::pair<TimeMs, TaskIndex>> delayed_;                     // Ready at.
  std::unordered_map<TaskIndex, std::vector<Lease>> leases_;           // At most two a task.
  std::set<std::tuple<TimeMs, TaskIndex, std::uint32_t>> lease_ends_;  // End, task, attempt.
  std::set<std::pair<TimeMs, TaskIndex>> alone_;                       // Since when tasks run that were never hedged.
  std::set<std::tuple<TimeMs, std::string, std::string>> revoked_;     // Slot's end, worker, key.
  std::set<IdleRank> idle_;                                            // Workers with credit left.
  std::multiset<std::uint64_t> memory_limits_;                         // Of all workers.
  std::map<std::string, Host> hosts_;
  std::set<std::string> changed_hosts_;                                      // Since ShareProcessors.
  std::map<std::tuple<JobNumber, int, std::uint32_t>, std::string> groups_;  // Job, kind, locality -> the host that began it.
};

}  // namespace trem
