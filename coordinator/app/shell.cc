#include "coordinator/app/shell.h"

#include <algorithm>

#include "mosaic/base/log.h"
#include "mosaic/base/version.h"
#include "proto/codec/convert.h"
#include "proto/codec/envelope.h"
#include "proto/codec/sortie_spec.h"

namespace trem {
namespace {

Attempt FromProto(const v1::TaskAttempt& message) { return {message.task_key(), message.attempt()}; }

void ToProto(const Attempt& attempt, v1::TaskAttempt* message) {
  message->set_task_key(attempt.task_key);
  message->set_attempt(attempt.number);
}

TaskDoneEvent MakeDoneEvent(const std::string& worker_id, const v1::Done& done) {
  TaskDoneEvent event;
  event.worker_id = worker_id;
  event.attempt = FromProto(done.attempt());
  event.code = static_cast<StatusCode>(done.status_code());
  event.message = done.message();
  event.result = done.result();
  event.elapsed_ms = done.elapsed_ms();
  event.peak_memory_bytes = done.peak_memory_bytes();
  event.bad_artefacts.assign(done.bad_artefacts().begin(), done.bad_artefacts().end());
  return event;
}

v1::Envelope ErrorEnvelope(const Status& status) {
  v1::Envelope envelope;
  envelope.mutable_error()->set_status_code(static_cast<std::uint32_t>(status.code()));
  envelope.mutable_error()->set_message(status.message());
  return envelope;
}

}  // namespace

Shell::Shell(std::unique_ptr<EventStore> events, ArtefactStore artefacts, const ShellOptions& options, SendFunction send)
    : events_(std::move(events)),
      artefacts_(std::move(artefacts)),
      options_(options),
      send_(std::move(send)),
      scheduler_(options.scheduler) {
  if (!options_.job_log_folder.empty()) job_log_ = std::make_unique<JobLog>(options_.job_log_folder, options_.job_log);
}

Result<std::unique_ptr<Shell>> Shell::Create(std::unique_ptr<EventStore> events, ArtefactStore artefacts, const ShellOptions& options,
                                             SendFunction send) {
  std::unique_ptr<Shell> shell(new Shell(std::move(events), std::move(artefacts), options, std::move(send)));
  TREM_RETURN_IF_ERROR(shell->Replay());
  return shell;
}

// ---- The log ----------------------------------------------------------------------------------------------------------------------

Status Shell::Replay() {
  std::int64_t event_count = 0;
  std::int64_t missing_count = 0;
  TREM_RETURN_IF_ERROR(events_->Replay([&](std::int64_t sequence, const v1::LogEvent& event) -> Status {
    ++event_count;
    if (event.has_task_committed() && !ArtefactsArePresent(event.task_committed())) {
      ++missing_count;
      return {};
    }
    const Status status = scheduler_.Restore(event);
    return status.ok() ? status : status.WithPrefix(events_->path().string() + ", event " + std::to_string(sequence));
  }));
  if (event_count > 0) spdlog::info("restored {} events from {}", event_count, events_->path().string());
  if (missing_count > 0) spdlog::warn("{} finished tasks will run again where they are needed: their artefacts are gone", missing_count);
  CompactWhenLong();
  return {};
}

void Shell::CompactWhenLong() {
  const bool is_long = events_->event_count() > std::max(options_.compact_after_events, 2 * events_->snapshot_count());
  if ((!is_long && !compact_next_) || events_->is_compacting()) return;
  compact_next_ = false;
  events_->BeginCompaction(scheduler_.BeginSnapshot());
}

bool Shell::ArtefactsArePresent(const v1::TaskCommitted& committed) const {
  if (!options_.store_elsewhere.empty()) return true;
  for (const v1::ArtefactRef& output : committed.result().outputs()) {
    const auto located = artefacts_.Locate(::trem::FromProto(output));
    if (located.ok()) continue;
    spdlog::warn("task {}: {}", committed.task_key(), located.status().message());
    return false;
  }
  return true;
}

void Shell::Feed(TimeMs now_ms, const Event& event) {
  for (const Effect& effect : scheduler_.Step(now_ms, event)) Take(effect);
}

void Shell::Take(const Effect& effect) {
  v1::Envelope envelope;
  if (const auto* append = std::get_if<AppendEffect>(&effect)) {
    unlogged_.push_back(append->event);
  } else if (const auto* dispatch = std::get_if<DispatchEffect>(&effect)) {
    NoteTask(dispatch->task.key(), dispatch->attempt, dispatch->worker_id, "handed out");
    LogWith(spdlog::level::debug, v1::TaskKind_Name(dispatch->task.kind()) + " handed out",
            {{"task", dispatch->task.key()}, {"attempt", std::to_string(dispatch->attempt)}, {"worker", dispatch->worker_id}});
    *envelope.mutable_dispatch()->mutable_task() = dispatch->task;
    envelope.mutable_dispatch()->set_attempt(dispatch->attempt);
    envelope.mutable_dispatch()->set_lease_ms(dispatch->lease_ms);
    SendToWorker(dispatch->worker_id, std::move(envelope));
  } else if (const auto* ack = std::get_if<AckEffect>(&effect)) {
    ToProto(ack->attempt, envelope.mutable_ack()->mutable_attempt());
    SendToWorker(ack->worker_id, std::move(envelope));
  } else if (const auto* cancel = std::get_if<CancelTaskEffect>(&effect)) {
    ToProto(cancel->attempt, envelope.mutable_cancel_task()->mutable_attempt());
    envelope.mutable_cancel_task()->set_reason(cancel->reason);
    SendToWorker(cancel->worker_id, std::move(envelope));
  } else if (const auto* share = std::get_if<ShareEffect>(&effect)) {
    ToProto(share->attempt, envelope.mutable_share()->mutable_attempt());
    envelope.mutable_share()->set_processors(share->processors);
    SendToWorker(share->worker_id, std::move(envelope));
  } else if (const auto* drain = std::get_if<DrainWorkerEffect>(&effect)) {
    envelope.mutable_drain()->set_reason("asked to by a client");
    SendToWorker(drain->worker_id, std::move(envelope));
  } else if (const auto* changed = std::get_if<JobChangedEffect>(&effect)) {
    const auto status = scheduler_.JobStatus(changed->job_id);
    const std::string text = v1::JobState_Name(status->state()) + (status->error().empty() ? "" : ": ") + status->error();
    LogWith(spdlog::level::info, text, {{"job", changed->job_id}});
    v1::LogLine line;
    line.set_text(text);
    line.set_warning(status->state() == v1::JOB_FAILED);
    NoteJob(changed->job_id, std::move(line));
  } else if (const auto* log = std::get_if<LogEffect>(&effect)) {
    spdlog::warn("{}", log->text);
    NoteTask(log->task_key, 0, "", log->text, true);
  }
}

Status Shell::Flush() {
  const Status appended = events_->Append(unlogged_);
  if (appended.code() == StatusCode::kExhausted) {
    if (!is_full_) spdlog::error("{}; nothing new is accepted until there is room", appended.message());
    is_full_ = true;
    return {};
  }
  TREM_RETURN_IF_ERROR(appended);
  if (is_full_) spdlog::warn("there is room for {} again; going on", events_->path().string());
  is_full_ = false;
  if (options_.on_logged && !unlogged_.empty()) options_.on_logged(unlogged_);
  unlogged_.clear();
  if (job_log_) job_log_->Flush();
  CompactWhenLong();
  for (const auto& [peer, envelope] : unsent_) {
    if (send_(peer, envelope) || !envelope.has_dispatch()) continue;
    // The worker is gone or deaf: no need to wait for its heartbeats to stay away.
    if (const auto worker = worker_ids_.find(peer); worker != worker_ids_.end()) {
      workers_.at(worker->second).last_heard_ms = 0;
    }
  }
  unsent_.clear();
  return {};
}

void Shell::SendTo(const std::string& peer, v1::Envelope envelope) { unsent_.emplace_back(peer, std::move(envelope)); }

void Shell::SendToWorker(const std::string& worker_id, v1::Envelope envelope) {
  const auto worker = workers_.find(worker_id);
  if (worker != workers_.end()) SendTo(worker->second.peer, std::move(envelope));
}

void Shell::Refuse(const std::string& peer, const Status& status) { SendTo(peer, ErrorEnvelope(status)); }

// ---- Messages ---------------------------------------------------------------------------------------------------------------------

// Workers repeat what matters, so that nothing need be kept; they only have to know that somebody is there.
void Shell::ReceiveWhileFull(TimeMs now_ms, const std::string& peer, const v1::Envelope& envelope) {
  if (const auto worker = worker_ids_.find(peer); worker != worker_ids_.end()) {
    workers_.at(worker->second).last_heard_ms = now_ms;
    return;
  }
  if (envelope.has_shutdown()) shutdown_requested_ = true;
  if (envelope.has_hello() || envelope.has_heartbeat() || envelope.has_progress() || envelope.has_done() || envelope.has_goodbye() ||
      envelope.has_task_log()) {
    return;
  }
  const std::string text = "the disk that holds " + events_->path().string() +
                           " is full: the coordinator answers again when there is room; nothing that was accepted is lost";
  send_(peer, ErrorEnvelope(Exhausted(text)));
}

void Shell::Receive(TimeMs now_ms, const std::string& peer, const v1::Envelope& envelope) {
  if (is_full_) return ReceiveWhileFull(now_ms, peer, envelope);
  switch (envelope.body_case()) {
    case v1::Envelope::kHello:
      return OnHello(now_ms, peer, envelope.hello());
    case v1::Envelope::kProgress:
    case v1::Envelope::kDone:
    case v1::Envelope::kGoodbye:
    case v1::Envelope::kHeartbeat:
    case v1::Envelope::kTaskLog:
      return OnWorkerMessage(now_ms, peer, envelope);
    case v1::Envelope::kSubmitJob:
      return OnSubmitJob(now_ms, peer, envelope.submit_job());
    case v1::Envelope::kGetJob:
      return ReplyJobStatus(peer, envelope.get_job().job_id());
    case v1::Envelope::kListJobs:
      return ReplyJobList(peer);
    case v1::Envelope::kCancelJob:
      return OnCancelJob(now_ms, peer, envelope.cancel_job());
    case v1::Envelope::kRemoveJob:
      return OnRemoveJob(now_ms, peer, envelope.remove_job());
    case v1::Envelope::kRetryJob:
      Feed(now_ms, RetryJobEvent{envelope.retry_job().job_id()});
      return ReplyJobStatus(peer, envelope.retry_job().job_id());
    case v1::Envelope::kDrainWorker:
      return OnDrainWorker(now_ms, peer, envelope.drain_worker());
    case v1::Envelope::kListWorkers:
      return OnListWorkers(now_ms, peer);
    case v1::Envelope::kGetLog:
      return OnGetLog(peer, envelope.get_log());
    case v1::Envelope::kBackup:
      return OnBackup(peer, envelope.backup());
    case v1::Envelope::kListArtefacts:
      return OnListArtefacts(peer, envelope.list_artefacts());
    case v1::Envelope::kGetServiceReport:
      return OnGetServiceReport(now_ms, peer, envelope.get_service_report());
    case v1::Envelope::kShutdown: {
      spdlog::info("a client asked for the end");
      shutdown_requested_ = true;
      v1::Envelope reply;
      reply.mutable_bye();
      return SendTo(peer, std::move(reply));
    }
    default:
      return Refuse(peer, InvalidInput("the coordinator does not take messages of kind " + std::to_string(envelope.body_case())));
  }
}

void Shell::ReceiveBroken(const std::string& peer, const Status& status) {
  spdlog::warn("a message was refused: {}", status.message());
  Refuse(peer, status);
}

void Shell::OnHello(TimeMs now_ms, const std::string& peer, const v1::Hello& hello) {
  Status refusal;
  if (hello.protocol_version() != kProtocolVersion) {
    refusal = InvalidInput("worker " + hello.worker_id() + " speaks protocol version " + std::to_string(hello.protocol_version()) +
                           "; this coordinator speaks version " + std::to_string(kProtocolVersion) + ": run the same release of both");
  } else if (hello.engine_revision() != kEngineRevision) {
    refusal = InvalidInput("worker " + hello.worker_id() + " has engine revision '" + hello.engine_revision() +
                           "'; this coordinator has '" + kEngineRevision + "': run the same release of both");
  }
  if (!refusal.ok()) {
    spdlog::warn("{}", refusal.message());
    NoteRefused(now_ms, hello, refusal.message());
    return Refuse(peer, refusal);
  }
  // The connection may have belonged to another process, and the worker may have come back on another connection.
  if (const auto old = worker_ids_.find(peer); old != worker_ids_.end() && old->second != hello.worker_id()) {
    const std::string old_id = old->second;
    Feed(now_ms, WorkerLostEvent{old_id});
    ForgetWorker(old_id);
  }
  const bool is_new = workers_.count(hello.worker_id()) == 0;
  if (!is_new) worker_ids_.erase(workers_.at(hello.worker_id()).peer);
  workers_[hello.worker_id()] = {peer, now_ms, ClockAheadMs(hello)};
  worker_ids_[peer] = hello.worker_id();
  if (is_new) {
    LogWith(spdlog::level::info, "worker joined",
            {{"worker", hello.worker_id()}, {"host", hello.host()}, {"pid", std::to_string(hello.pid())}});
  }

  AdaptHeartbeats();
  SendTo(peer, WelcomeEnvelope());

  WorkerHelloEvent event;
  event.worker_id = hello.worker_id();
  event.host = hello.host();
  event.pid = hello.pid();
  event.credit = hello.credit();
  event.memory_bytes_max = hello.memory_bytes_max();
  for (const v1::TaskAttempt& attempt : hello.running()) event.running.push_back(FromProto(attempt));
  Feed(now_ms, event);
}

// How far the worker's clock is ahead of this one, less the way of the message.
std::int64_t Shell::ClockAheadMs(const v1::Hello& hello) const {
  if (hello.clock_ms() == 0 || !options_.wall_clock_ms) return 0;
  return static_cast<std::int64_t>(hello.clock_ms()) - static_cast<std::int64_t>(options_.wall_clock_ms());
}

v1::Envelope Shell::WelcomeEnvelope() const {
  v1::Envelope welcome;
  welcome.mutable_welcome()->set_heartbeat_interval_ms(static_cast<std::uint32_t>(HeartbeatIntervalMs()));
  welcome.mutable_welcome()->set_store_path(StorePath());
  return welcome;
}

// Told to all when it changes: it is also what they judge a silence by. It falls late, so that a fleet about a step in size does not
// flutter.
void Shell::AdaptHeartbeats() {
  const auto factor = static_cast<std::uint32_t>(1 + workers_.size() / std::max(1U, options_.heartbeat_fleet_step));
  if (factor <= heartbeat_factor_ && 2 * factor >= heartbeat_factor_) return;
  heartbeat_factor_ = factor;
  for (const auto& [worker_id, worker] : workers_) SendTo(worker.peer, WelcomeEnvelope());
}

void Shell::OnWorkerMessage(TimeMs now_ms, const std::string& peer, const v1::Envelope& envelope) {
  const auto found = worker_ids_.find(peer);
  if (found == worker_ids_.end()) {
    // After a restart of the coordinator, or when the worker was taken for lost: it has to say again who it is and what it runs.
    if (!envelope.has_goodbye()) Refuse(peer, Unavailable("the coordinator does not know this worker (any more); say Hello"));
    return;
  }
  const std::string worker_id = found->second;
  workers_.at(worker_id).last_heard_ms = now_ms;
  if (envelope.has_progress()) {
    Feed(now_ms, ProgressEvent{worker_id, FromProto(envelope.progress().attempt()), envelope.progress().fraction()});
  } else if (envelope.has_task_log()) {
    OnTaskLog(worker_id, envelope.task_log());
  } else if (envelope.has_done()) {
    NoteDone(worker_id, envelope.done());
    Feed(now_ms, MakeDoneEvent(worker_id, envelope.done()));
  } else if (envelope.has_goodbye()) {
    LogWith(spdlog::level::info, "worker left: " + envelope.goodbye().reason(), {{"worker", worker_id}});
    Feed(now_ms, WorkerGoodbyeEvent{worker_id});
    ForgetWorker(worker_id);
  }
}

void Shell::OnSubmitJob(TimeMs now_ms, const std::string& peer, const v1::SubmitJob& submit) {
  if (!IsJobId(submit.job_id())) {
    return Refuse(peer, InvalidInput("job id '" + submit.job_id().substr(0, 80) + "' is malformed; expected 1 to 64 of a-z, 0-9 and '-'"));
  }
  v1::Sortie sortie = submit.sortie();
  if (const Status status = CompleteSortie(&sortie); !status.ok()) return Refuse(peer, status);
  const v1::Sortie* known = scheduler_.FindSortie(submit.job_id());
  if (known != nullptr && SerializeDeterministic(*known) != SerializeDeterministic(sortie)) {
    return Refuse(peer, InvalidInput("job '" + submit.job_id() + "' exists with another sortie; choose another job id"));
  }
  if (known == nullptr && options_.user_jobs_max != 0 && scheduler_.RunningJobCount(submit.user()) >= options_.user_jobs_max) {
    return Refuse(peer, Exhausted("user '" + submit.user() + "' has " + std::to_string(options_.user_jobs_max) +
                                  " jobs running, which is the limit; submit it again when one has ended"));
  }
  if (known == nullptr && !no_jobs_because_.empty()) return Refuse(peer, Exhausted(no_jobs_because_));
  Feed(now_ms, SubmitJobEvent{submit.job_id(), sortie, submit.user(), submit.priority()});
  ReplyJobStatus(peer, submit.job_id());
}

void Shell::OnCancelJob(TimeMs now_ms, const std::string& peer, const v1::CancelJob& cancel) {
  if (scheduler_.FindSortie(cancel.job_id()) != nullptr) Feed(now_ms, CancelJobEvent{cancel.job_id()});
  ReplyJobStatus(peer, cancel.job_id());
}

void Shell::OnDrainWorker(TimeMs now_ms, const std::string& peer, const v1::DrainWorker& drain) {
  if (workers_.count(drain.worker_id()) == 0) {
    return Refuse(peer, NotFound("there is no worker '" + drain.worker_id() + "'; `trem workers` shows all"));
  }
  Feed(now_ms, DrainWorkerEvent{drain.worker_id()});
  OnListWorkers(now_ms, peer);
}

void Shell::OnListWorkers(TimeMs now_ms, const std::string& peer) {
  v1::Envelope reply;
  v1::WorkerList* list = reply.mutable_worker_list();
  for (v1::WorkerStatus& status : scheduler_.WorkerStatuses()) {
    if (const auto worker = workers_.find(status.worker_id()); worker != workers_.end()) {
      status.set_last_seen_ms_ago(static_cast<std::uint64_t>(now_ms - worker->second.last_heard_ms));
      status.set_clock_ahead_ms(worker->second.clock_ahead_ms);
    }
    *list->add_workers() = std::move(status);
  }
  SendTo(peer, std::move(reply));
}

void Shell::ReplyJobStatus(const std::string& peer, const std::string& job_id) {
  const auto status = scheduler_.JobStatus(job_id);
  if (!status.has_value()) return Refuse(peer, NotFound("there is no job '" + job_id.substr(0, 80) + "'; `trem list` shows all"));
  v1::Envelope reply;
  *reply.mutable_job_status() = *status;
  reply.mutable_job_status()->set_store_path(StorePath());
  SendTo(peer, std::move(reply));
}

void Shell::ReplyJobList(const std::string& peer) {
  v1::Envelope reply;
  v1::JobList* list = reply.mutable_job_list();  // Made even when there is no job: an empty list is an answer too.
  for (v1::JobStatus& status : scheduler_.JobStatuses()) {
    status.clear_notes();  // GetJob tells them; thousands of jobs with notes would not fit one message.
    status.set_store_path(StorePath());
    *list->add_jobs() = std::move(status);
  }
  SendTo(peer, std::move(reply));
}

void Shell::ForgetWorker(const std::string& worker_id) {
  const auto worker = workers_.find(worker_id);
  if (worker == workers_.end()) return;
  worker_ids_.erase(worker->second.peer);
  workers_.erase(worker);
}

void Shell::Tick(TimeMs now_ms) {
  if (is_full_) {
    if (now_ms < next_heartbeat_ms_) return;
    next_heartbeat_ms_ = now_ms + HeartbeatIntervalMs();
    v1::Envelope heartbeat;
    heartbeat.mutable_heartbeat();
    for (const auto& [worker_id, worker] : workers_) send_(worker.peer, heartbeat);
    return;
  }
  const TimeMs silence_ms_max = HeartbeatIntervalMs() * options_.heartbeats_missed_max;
  std::vector<std::string> lost;
  for (const auto& [worker_id, worker] : workers_) {
    if (now_ms - worker.last_heard_ms > silence_ms_max) lost.push_back(worker_id);
  }
  for (const std::string& worker_id : lost) {
    LogWith(spdlog::level::warn, "worker was silent for more than " + std::to_string(silence_ms_max) + " ms and is taken for lost",
            {{"worker", worker_id}});
    Feed(now_ms, WorkerLostEvent{worker_id});
    ForgetWorker(worker_id);
  }
  if (!lost.empty()) AdaptHeartbeats();
  Feed(now_ms, TickEvent{});
  if (now_ms >= next_heartbeat_ms_) {
    next_heartbeat_ms_ = now_ms + HeartbeatIntervalMs();
    for (const auto& [worker_id, worker] : workers_) {
      v1::Envelope heartbeat;
      heartbeat.mutable_heartbeat();
      SendTo(worker.peer, std::move(heartbeat));
    }
  }
}

}  // namespace trem
