#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "coordinator/scheduling/scheduler.h"
#include "coordinator/store/event_store.h"
#include "coordinator/store/job_log.h"
#include "mosaic/base/artefact_store.h"
#include "mosaic/base/status.h"
#include "proto/trem/v1/fleet.pb.h"

namespace trem {

struct ShellOptions {
  SchedulerOptions scheduler;
  // How often coordinator and workers let each other hear of them when there is nothing to say; longer as the fleet grows, by once more for
  // every `heartbeat_fleet_step` workers, so that thousands that wait cost next to nothing.
  std::uint32_t heartbeat_interval_ms = 500;
  std::uint32_t heartbeat_fleet_step = 200;
  // A worker that was silent for this many intervals is lost and its tasks go to others. Fewer: a stopped worker is noticed sooner, but a
  // busy machine may lose live ones.
  std::uint32_t heartbeats_missed_max = 8;
  // The log is replaced by a snapshot when it has more events than this, and twice as many as the last snapshot.
  std::uint64_t compact_after_events = 200'000;
  // An artefact store that this process cannot look into (/vsis3/...): told to workers and clients instead of the folder's path, and what
  // the log says is in it is believed.
  std::string store_elsewhere;
  // Told of events as soon as they are durable; for metrics. May be empty.
  std::function<void(std::span<const v1::LogEvent>)> on_logged;
  // Where the logs of jobs are kept; empty: nowhere.
  std::filesystem::path job_log_folder;
  JobLogOptions job_log;
  // Where backups of the log are written; empty: nowhere.
  std::filesystem::path backup_folder;
  // Told to those who ask how the service does. The id belongs to the state folder; the limit is held by others. 0: none.
  std::string state_id;
  std::uint64_t store_bytes_max = 0;
  // Milliseconds since 1970, for the logs of jobs and to compare clocks.
  std::function<std::uint64_t()> wall_clock_ms;
  // Jobs that one user may have running at once; more are refused. 0: no limit.
  std::uint32_t user_jobs_max = 0;
};

// What stands between the outside and the pure scheduler: turns messages into events, makes the scheduler's log events durable, and
// only then lets messages leave. Knows no socket (it is given a function to send with) and no clock (it is given the time), so tests
// drive it by hand. Not thread-safe.
class Shell {
 public:
  // Delivers one message; false when the peer is not reachable.
  using SendFunction = std::function<bool(const std::string& peer, const v1::Envelope& envelope)>;

  // Rebuilds the state from the log. A committed task whose artefacts are missing from `artefacts` is run again.
  static Result<std::unique_ptr<Shell>> Create(std::unique_ptr<EventStore> events, ArtefactStore artefacts, const ShellOptions& options,
                                               SendFunction send);

  // Takes one message in. What is to be sent waits for Flush.
  void Receive(TimeMs now_ms, const std::string& peer, const v1::Envelope& envelope);
  // A message that could not be decoded.
  void ReceiveBroken(const std::string& peer, const Status& status);
  // Heartbeats, lost workers, ended leases. Call every 100 ms or so, when every message that waited has been taken in.
  void Tick(TimeMs now_ms);
  // Appends what must survive to the log, then sends. When the disk is full nothing leaves and nothing new is taken in until a later call
  // finds room; clients are told. On another failure the state is ahead of the log: the caller has to give up, and a new Shell starts from
  // the log.
  Status Flush();

  const Scheduler& scheduler() const { return scheduler_; }
  // A client asked for the end.
  bool shutdown_requested() const { return shutdown_requested_; }
  // Goes on with what is done a little at a time (a backup, a new snapshot). True while something is left: call it again soon.
  bool Maintain();
  // Digests of all artefacts that some job has made or was submitted with, in any order. An upload's list that cannot be read is an error:
  // what it names is not known.
  Result<std::vector<std::string>> ArtefactsInUse() const;
  // What was in use when jobs were removed since the last call; empty: none was.
  std::vector<std::string> TakeReleased() { return std::exchange(released_, {}); }
  // Refuses new jobs for this reason; empty: takes them again.
  void RefuseJobs(std::string reason) { no_jobs_because_ = std::move(reason); }
  // What the artefact store held when it was last looked at.
  void NoteStoreBytes(std::uint64_t bytes) { store_bytes_ = bytes; }
  std::uint64_t store_bytes() const { return store_bytes_; }
  // The disk that holds the log is full.
  bool is_full() const { return is_full_; }

 private:
  struct Peer {
    std::string peer;  // Identity of its connection.
    TimeMs last_heard_ms = 0;
    std::int64_t clock_ahead_ms = 0;
  };
  // A worker of another release that asked to join.
  struct Refused {
    v1::RefusedWorker worker;
    TimeMs at_ms = 0;
  };

  Shell(std::unique_ptr<EventStore> events, ArtefactStore artefacts, const ShellOptions& options, SendFunction send);

  Status Replay();
  void CompactWhenLong();
  void ReceiveWhileFull(TimeMs now_ms, const std::string& peer, const v1::Envelope& envelope);
  std::string StorePath() const { return options_.store_elsewhere.empty() ? artefacts_.root().string() : options_.store_elsewhere; }
  bool ArtefactsArePresent(const v1::TaskCommitted& committed) const;
  void Feed(TimeMs now_ms, const Event& event);
  void Take(const Effect& effect);
  void SendTo(const std::string& peer, v1::Envelope envelope);
  void SendToWorker(const std::string& worker_id, v1::Envelope envelope);
  void Refuse(const std::string& peer, const Status& status);

  void OnHello(TimeMs now_ms, const std::string& peer, const v1::Hello& hello);
  std::int64_t ClockAheadMs(const v1::Hello& hello) const;
  void OnWorkerMessage(TimeMs now_ms, const std::string& peer, const v1::Envelope& envelope);
  void OnSubmitJob(TimeMs now_ms, const std::string& peer, const v1::SubmitJob& submit);
  void OnCancelJob(TimeMs now_ms, const std::string& peer, const v1::CancelJob& cancel);
  void OnRemoveJob(TimeMs now_ms, const std::string& peer, const v1::RemoveJob& remove);
  void OnDrainWorker(TimeMs now_ms, const std::string& peer, const v1::DrainWorker& drain);
  void OnListWorkers(TimeMs now_ms, const std::string& peer);
  void ReplyJobStatus(const std::string& peer, const std::string& job_id);
  void ReplyJobList(const std::string& peer);
  void ForgetWorker(const std::string& worker_id);
  TimeMs HeartbeatIntervalMs() const { return static_cast<TimeMs>(options_.heartbeat_interval_ms) * heartbeat_factor_; }
  void AdaptHeartbeats();
  v1::Envelope WelcomeEnvelope() const;

  // What operators ask for (shell_operations.cc).
  void OnTaskLog(const std::string& worker_id, const v1::TaskLog& log);
  void NoteDone(const std::string& worker_id, const v1::Done& done);
  void OnGetLog(const std::string& peer, const v1::GetLog& get);
  void OnBackup(const std::string& peer, const v1::Backup& backup);
  void OnGetServiceReport(TimeMs now_ms, const std::string& peer, const v1::GetServiceReport& get);
  void OnListArtefacts(const std::string& peer, const v1::ListArtefacts& list);
  void NoteRefused(TimeMs now_ms, const v1::Hello& hello, const std::string& reason);
  // A line in the log of a job, or of every job that shares a task.
  void NoteJob(const std::string& job_id, v1::LogLine line);
  void NoteTask(const std::string& task_key, std::uint32_t attempt, const std::string& worker_id, const std::string& text,
                bool is_warning = false);

  std::unique_ptr<EventStore> events_;
  ArtefactStore artefacts_;
  ShellOptions options_;
  SendFunction send_;
  Scheduler scheduler_;
  std::map<std::string, Peer> workers_;            // Worker id -> connection.
  std::map<std::string, std::string> worker_ids_;  // Connection -> worker id.
  std::vector<v1::LogEvent> unlogged_;
  std::vector<std::pair<std::string, v1::Envelope>> unsent_;
  TimeMs next_heartbeat_ms_ = 0;
  std::uint32_t heartbeat_factor_ = 1;
  std::unique_ptr<JobLog> job_log_;  // May be null.
  bool shutdown_requested_ = false;
  bool is_full_ = false;
  bool compact_next_ = false;  // However short the log is.
  std::vector<std::string> released_;
  std::string no_jobs_because_;
  std::uint64_t store_bytes_ = 0;
  std::map<std::string, Refused> refused_;  // By host, so that one that tries again and again leaves room for others.
};

}  // namespace trem
