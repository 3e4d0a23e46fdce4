// ValidateEnvelope: what every message must fulfil before anybody looks at it.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <string>

#include "mosaic/base/digest.h"
#include "proto/codec/envelope.h"

namespace trem {
namespace {

constexpr std::size_t kIdLengthMaxJob = 64;
constexpr std::size_t kIdLengthMaxWorker = 128;
constexpr std::size_t kWordBytesMax = 256;    // Host names, revisions, codes.
constexpr std::size_t kTextBytesMax = 65536;  // Messages, reasons, paths.
constexpr std::size_t kChunkBytesMax = std::size_t{4} << 20;
constexpr int kLogLinesMax = 256;  // Of one message of a worker.
constexpr std::size_t kLogLineBytesMax = 4096;
constexpr std::uint32_t kCreditMax = 1024;
constexpr std::uint32_t kProcessorsMax = 4096;
constexpr std::uint32_t kDurationMsMax = 86'400'000;  // A day.
constexpr std::uint32_t kStatusCodeMax = static_cast<std::uint32_t>(StatusCode::kFailed);

bool IsId(std::string_view text, std::size_t length_max) {
  return !text.empty() && text.size() <= length_max &&
         std::all_of(text.begin(), text.end(), [](char c) { return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '-'; });
}

Status Bad(const std::string& field, const std::string& found, const std::string& expected) {
  return Corrupt(fmt::format("{} is {}; expected {}", field, found, expected));
}

Status CheckText(const char* field, const std::string& text, std::size_t bytes_max) {
  return text.size() <= bytes_max ? Status() : Bad(field, fmt::format("{} bytes long", text.size()), fmt::format("at most {}", bytes_max));
}

Status CheckRange(const char* field, double value, double least, double most) {
  return value >= least && value <= most ? Status() : Bad(field, fmt::format("{}", value), fmt::format("{} to {}", least, most));
}

Status CheckFinite(const char* field, double value) {
  return std::isfinite(value) ? Status() : Bad(field, fmt::format("{}", value), "a finite number");
}

Status CheckJobId(const std::string& id) {
  return IsJobId(id) ? Status() : Bad("job_id", fmt::format("'{}'", id.substr(0, kIdLengthMaxJob)), "1 to 64 of a-z, 0-9 and '-'");
}

Status CheckWorkerId(const std::string& id) {
  return IsWorkerId(id) ? Status()
                        : Bad("worker_id", fmt::format("'{}'", id.substr(0, kIdLengthMaxWorker)), "1 to 128 of a-z, 0-9 and '-'");
}

Status CheckDigest(const char* field, const std::string& digest) {
  return IsSha256Hex(digest) ? Status() : Bad(field, fmt::format("'{}'", digest.substr(0, 64)), "64 lower-case hexadecimal digits");
}

Status Validate(const v1::TaskAttempt& attempt) { return CheckDigest("task_key", attempt.task_key()); }

template <typename Attempts>
Status ValidateRunning(const Attempts& running) {
  if (running.size() > static_cast<int>(kCreditMax)) return Bad("running", fmt::format("{} attempts", running.size()), "at most 1024");
  for (const v1::TaskAttempt& attempt : running) TREM_RETURN_IF_ERROR(Validate(attempt));
  return {};
}

Status Validate(const v1::ArtefactRef& ref) {
  TREM_RETURN_IF_ERROR(CheckText("artefact name", ref.name(), kWordBytesMax));
  return CheckDigest("artefact digest", ref.sha256());
}

Status Validate(const v1::Note& note) {
  TREM_RETURN_IF_ERROR(CheckText("note code", note.code(), kWordBytesMax));
  TREM_RETURN_IF_ERROR(CheckText("note subject", note.subject(), kTextBytesMax));
  TREM_RETURN_IF_ERROR(CheckText("note message", note.message(), kTextBytesMax));
  return v1::Severity_IsValid(note.severity()) ? Status() : Bad("note severity", fmt::format("{}", note.severity()), "INFO or WARNING");
}

// Declared here because the template below finds only what stands before it.
Status Validate(const v1::StageStatus& stage);
Status Validate(const v1::JobStatus& job);
Status Validate(const v1::WorkerStatus& worker);
Status Validate(const v1::LogLine& line);
Status Validate(const v1::RefusedWorker& worker);

template <typename Messages>
Status ValidateAll(const Messages& messages) {
  for (const auto& message : messages) TREM_RETURN_IF_ERROR(Validate(message));
  return {};
}

Status CheckKind(v1::TaskKind kind) {
  return v1::TaskKind_IsValid(kind) && kind != v1::TASK_KIND_UNSPECIFIED ? Status()
                                                                         : Bad("task kind", fmt::format("{}", kind), "INGEST to EXPORT");
}

Status CheckStatusCode(std::uint32_t code) {
  return code <= kStatusCodeMax ? Status() : Bad("status_code", fmt::format("{}", code), fmt::format("0 to {}", kStatusCodeMax));
}

Status Validate(const v1::RoiMessage& roi) {
  return roi.x0() <= roi.x1() && roi.y0() <= roi.y1()
             ? Status()
             : Bad("roi", fmt::format("[{}, {}) x [{}, {})", roi.x0(), roi.x1(), roi.y0(), roi.y1()), "x0 <= x1 and y0 <= y1");
}

Status Validate(const v1::Hello& hello) {
  TREM_RETURN_IF_ERROR(CheckWorkerId(hello.worker_id()));
  TREM_RETURN_IF_ERROR(CheckText("host", hello.host(), kWordBytesMax));
  TREM_RETURN_IF_ERROR(CheckText("engine_revision", hello.engine_revision(), kWordBytesMax));
  if (hello.credit() > kCreditMax) return Bad("credit", fmt::format("{}", hello.credit()), "at most 1024");
  return ValidateRunning(hello.running());
}

Status Validate(const v1::Progress& progress) {
  TREM_RETURN_IF_ERROR(Validate(progress.attempt()));
  return CheckRange("fraction", progress.fraction(), 0.0, 1.0);
}

Status Validate(const v1::IngestSummary& ingest) {
  TREM_RETURN_IF_ERROR(Validate(ingest.valid_roi()));
  for (const v1::FrameSpan& span : ingest.spans()) {
    if (span.begin() >= span.end() || span.end() > ingest.frame_count()) {
      return Bad("span", fmt::format("[{}, {})", span.begin(), span.end()), fmt::format("frames within [0, {})", ingest.frame_count()));
    }
  }
  return CheckFinite("median_motion_px", ingest.median_motion_px());
}

Status Validate(const v1::Done& done) {
  TREM_RETURN_IF_ERROR(Validate(done.attempt()));
  TREM_RETURN_IF_ERROR(CheckStatusCode(done.status_code()));
  TREM_RETURN_IF_ERROR(CheckText("message", done.message(), kTextBytesMax));
  if ((done.status_code() == 0) != done.has_result()) {
    return Bad("done", done.has_result() ? "a failure with a result" : "a success without a result",
               "a result exactly when status_code is 0");
  }
  TREM_RETURN_IF_ERROR(ValidateAll(done.result().outputs()));
  for (const std::string& digest : done.bad_artefacts()) TREM_RETURN_IF_ERROR(CheckDigest("bad_artefacts", digest));
  TREM_RETURN_IF_ERROR(Validate(done.result().ingest()));
  return ValidateAll(done.result().notes());
}

Status Validate(const v1::Welcome& welcome) {
  TREM_RETURN_IF_ERROR(CheckRange("heartbeat_interval_ms", welcome.heartbeat_interval_ms(), 1, kDurationMsMax));
  return CheckText("store_path", welcome.store_path(), kTextBytesMax);
}

Status Validate(const v1::Dispatch& dispatch) {
  const v1::TaskSpec& task = dispatch.task();
  TREM_RETURN_IF_ERROR(CheckDigest("task_key", task.key()));
  TREM_RETURN_IF_ERROR(CheckKind(task.kind()));
  TREM_RETURN_IF_ERROR(ValidateAll(task.inputs()));
  TREM_RETURN_IF_ERROR(Validate(task.enhance().roi_in_sensor()));
  if (task.enhance().frame_begin() > task.enhance().frame_end()) {
    return Bad("enhance.frame_begin", fmt::format("{}", task.enhance().frame_begin()), "at most frame_end");
  }
  return CheckRange("lease_ms", dispatch.lease_ms(), 1, kDurationMsMax);
}

Status Validate(const v1::Ack& ack) { return Validate(ack.attempt()); }

Status Validate(const v1::CancelTask& cancel) {
  TREM_RETURN_IF_ERROR(Validate(cancel.attempt()));
  return CheckText("reason", cancel.reason(), kTextBytesMax);
}

Status Validate(const v1::Share& share) {
  TREM_RETURN_IF_ERROR(Validate(share.attempt()));
  return CheckRange("processors", share.processors(), 1, kProcessorsMax);
}

Status Validate(const v1::Drain& drain) { return CheckText("reason", drain.reason(), kTextBytesMax); }

Status Validate(const v1::Goodbye& goodbye) { return CheckText("reason", goodbye.reason(), kTextBytesMax); }

Status Validate(const v1::TaskLog& log) {
  TREM_RETURN_IF_ERROR(Validate(log.attempt()));
  if (log.lines_size() > kLogLinesMax)
    return Bad("lines", fmt::format("{} lines", log.lines_size()), fmt::format("at most {}", kLogLinesMax));
  for (const std::string& line : log.lines()) TREM_RETURN_IF_ERROR(CheckText("line", line, kLogLineBytesMax));
  return {};
}

Status Validate(const v1::GetLog& get) {
  TREM_RETURN_IF_ERROR(CheckJobId(get.job_id()));
  TREM_RETURN_IF_ERROR(CheckText("task", get.task(), kWordBytesMax));
  return get.worker_id().empty() ? Status() : CheckWorkerId(get.worker_id());
}

Status Validate(const v1::LogLine& line) {
  TREM_RETURN_IF_ERROR(CheckText("task", line.task(), kWordBytesMax));
  return CheckText("text", line.text(), kTextBytesMax);
}

Status Validate(const v1::BackupStatus& backup) {
  if (!IsJobId(backup.backup_id())) return Bad("backup_id", "malformed", "1 to 64 of a-z, 0-9 and '-'");
  TREM_RETURN_IF_ERROR(CheckText("path", backup.path(), kTextBytesMax));
  return CheckRange("fraction", backup.fraction(), 0.0, 1.0);
}

Status Validate(const v1::GetChunk& get) {
  TREM_RETURN_IF_ERROR(CheckDigest("sha256", get.sha256()));
  return CheckRange("bytes_max", get.bytes_max(), 1, kChunkBytesMax);
}

Status Validate(const v1::PutChunk& put) {
  TREM_RETURN_IF_ERROR(CheckDigest("sha256", put.sha256()));
  if (put.offset() <= put.bytes()) return {};
  return Bad("offset", fmt::format("{}", put.offset()), fmt::format("within the artefact's {} bytes", put.bytes()));
}

Status CheckUser(const std::string& user) {
  if (user.empty() || IsId(user, kIdLengthMaxJob)) return {};
  return Bad("user", fmt::format("'{}'", user.substr(0, kIdLengthMaxJob)), "at most 64 of a-z, 0-9 and '-'");
}

Status Validate(const v1::SubmitJob& submit) {
  TREM_RETURN_IF_ERROR(CheckJobId(submit.job_id()));
  TREM_RETURN_IF_ERROR(CheckUser(submit.user()));
  TREM_RETURN_IF_ERROR(CheckRange("priority", submit.priority(), -10, 10));
  return submit.has_sortie() ? Status() : Bad("sortie", "missing", "the job's spec");
}

Status Validate(const v1::StageStatus& stage) {
  TREM_RETURN_IF_ERROR(CheckKind(stage.kind()));
  return CheckFinite("running_fraction", stage.running_fraction());
}

Status Validate(const v1::JobStatus& job) {
  TREM_RETURN_IF_ERROR(CheckJobId(job.job_id()));
  TREM_RETURN_IF_ERROR(CheckText("name", job.name(), kTextBytesMax));
  if (!v1::JobState_IsValid(job.state())) return Bad("state", fmt::format("{}", job.state()), "a state that fleet.proto names");
  TREM_RETURN_IF_ERROR(ValidateAll(job.stages()));
  TREM_RETURN_IF_ERROR(CheckText("error", job.error(), kTextBytesMax));
  TREM_RETURN_IF_ERROR(CheckStatusCode(job.error_code()));
  TREM_RETURN_IF_ERROR(ValidateAll(job.outputs()));
  TREM_RETURN_IF_ERROR(ValidateAll(job.notes()));
  TREM_RETURN_IF_ERROR(ValidateAll(job.holes()));
  TREM_RETURN_IF_ERROR(CheckRange("fraction", job.fraction(), 0.0, 1.0));
  TREM_RETURN_IF_ERROR(CheckFinite("eta_low_s", job.eta_low_s()));
  TREM_RETURN_IF_ERROR(CheckFinite("eta_high_s", job.eta_high_s()));
  return CheckFinite("eta_s", job.eta_s());
}

Status Validate(const v1::WorkerStatus& worker) {
  TREM_RETURN_IF_ERROR(CheckWorkerId(worker.worker_id()));
  TREM_RETURN_IF_ERROR(CheckText("host", worker.host(), kWordBytesMax));
  for (const v1::RunningTask& task : worker.tasks()) {
    TREM_RETURN_IF_ERROR(CheckDigest("task_key", task.task_key()));
    TREM_RETURN_IF_ERROR(CheckText("title", task.title(), kWordBytesMax));
    TREM_RETURN_IF_ERROR(CheckRange("fraction", task.fraction(), 0.0, 1.0));
  }
  return ValidateRunning(worker.running());
}

Status Validate(const v1::RefusedWorker& worker) {
  TREM_RETURN_IF_ERROR(CheckWorkerId(worker.worker_id()));
  TREM_RETURN_IF_ERROR(CheckText("host", worker.host(), kWordBytesMax));
  return CheckText("reason", worker.reason(), kTextBytesMax);
}

Status Validate(const v1::ServiceReport& report) {
  constexpr int kRefusedWorkersMax = 64;
  for (const std::string* word : {&report.version(), &report.engine_revision(), &report.state_id()}) {
    TREM_RETURN_IF_ERROR(CheckText("version", *word, kWordBytesMax));
  }
  for (const std::string* text : {&report.state_path(), &report.store_path(), &report.refuses_jobs()}) {
    TREM_RETURN_IF_ERROR(CheckText("text of a report", *text, kTextBytesMax));
  }
  if (report.refused_workers_size() > kRefusedWorkersMax) {
    return Bad("refused_workers", fmt::format("{} entries", report.refused_workers_size()), fmt::format("at most {}", kRefusedWorkersMax));
  }
  return ValidateAll(report.refused_workers());
}

Status Validate(const v1::ArtefactList& list) {
  constexpr std::size_t kDigestBytes = 32;
  constexpr std::size_t kDigestsBytesMax = kDigestBytes << 19;
  const std::size_t bytes = list.digests().size();
  return bytes % kDigestBytes == 0 && bytes <= kDigestsBytesMax
             ? Status()
             : Bad("digests", fmt::format("{} bytes long", bytes), fmt::format("a multiple of 32, at most {}", kDigestsBytesMax));
}

Status Validate(const v1::ErrorReply& error) {
  TREM_RETURN_IF_ERROR(CheckStatusCode(error.status_code()));
  return CheckText("message", error.message(), kTextBytesMax);
}

Status ValidateBody(const v1::Envelope& envelope) {
  switch (envelope.body_case()) {
    case v1::Envelope::kHello:
      return Validate(envelope.hello());
    case v1::Envelope::kProgress:
      return Validate(envelope.progress());
    case v1::Envelope::kDone:
      return Validate(envelope.done());
    case v1::Envelope::kGoodbye:
      return Validate(envelope.goodbye());
    case v1::Envelope::kTaskLog:
      return Validate(envelope.task_log());
    case v1::Envelope::kGetLog:
      return Validate(envelope.get_log());
    case v1::Envelope::kLogPage:
      return ValidateAll(envelope.log_page().lines());
    case v1::Envelope::kBackup:
      return IsJobId(envelope.backup().backup_id()) ? Status() : Bad("backup_id", "malformed", "1 to 64 of a-z, 0-9 and '-'");
    case v1::Envelope::kBackupStatus:
      return Validate(envelope.backup_status());
    case v1::Envelope::kWelcome:
      return Validate(envelope.welcome());
    case v1::Envelope::kDispatch:
      return Validate(envelope.dispatch());
    case v1::Envelope::kAck:
      return Validate(envelope.ack());
    case v1::Envelope::kCancelTask:
      return Validate(envelope.cancel_task());
    case v1::Envelope::kDrain:
      return Validate(envelope.drain());
    case v1::Envelope::kShare:
      return Validate(envelope.share());
    case v1::Envelope::kSubmitJob:
      return Validate(envelope.submit_job());
    case v1::Envelope::kGetJob:
      return CheckJobId(envelope.get_job().job_id());
    case v1::Envelope::kRetryJob:
      return CheckJobId(envelope.retry_job().job_id());
    case v1::Envelope::kDrainWorker:
      return CheckWorkerId(envelope.drain_worker().worker_id());
    case v1::Envelope::kRemoveJob:
      return CheckJobId(envelope.remove_job().job_id());
    case v1::Envelope::kCancelJob:
      return CheckJobId(envelope.cancel_job().job_id());
    case v1::Envelope::kJobStatus:
      return Validate(envelope.job_status());
    case v1::Envelope::kJobList:
      return ValidateAll(envelope.job_list().jobs());
    case v1::Envelope::kWorkerList:
      return ValidateAll(envelope.worker_list().workers());
    case v1::Envelope::kError:
      return Validate(envelope.error());
    case v1::Envelope::kGetServiceReport:
      return CheckUser(envelope.get_service_report().user());
    case v1::Envelope::kListArtefacts:
      return envelope.list_artefacts().after().empty() ? Status() : CheckDigest("after", envelope.list_artefacts().after());
    case v1::Envelope::kArtefactList:
      return Validate(envelope.artefact_list());
    case v1::Envelope::kServiceReport:
      return Validate(envelope.service_report());
    case v1::Envelope::kDataLane:
      return CheckText("endpoint", envelope.data_lane().endpoint(), kTextBytesMax);
    case v1::Envelope::kGetChunk:
      return Validate(envelope.get_chunk());
    case v1::Envelope::kChunk:
      return CheckDigest("sha256", envelope.chunk().sha256());
    case v1::Envelope::kPutChunk:
      return Validate(envelope.put_chunk());
    case v1::Envelope::kPutReply:
      return CheckDigest("sha256", envelope.put_reply().sha256());
    case v1::Envelope::kGetDataLane:
    case v1::Envelope::kListJobs:
    case v1::Envelope::kListWorkers:
    case v1::Envelope::kShutdown:
    case v1::Envelope::kBye:
    case v1::Envelope::kHeartbeat:
      return {};
    case v1::Envelope::BODY_NOT_SET:
      break;
  }
  return Corrupt("an envelope without a body that this version knows");
}

}  // namespace

bool IsJobId(std::string_view text) { return IsId(text, kIdLengthMaxJob); }
bool IsWorkerId(std::string_view text) { return IsId(text, kIdLengthMaxWorker); }

Status ValidateEnvelope(const v1::Envelope& envelope) {
  const Status status = ValidateBody(envelope);
  if (status.ok() || envelope.body_case() == v1::Envelope::BODY_NOT_SET) return status;
  return status.WithPrefix(v1::Envelope::descriptor()->FindFieldByNumber(envelope.body_case())->name());
}

bool CarriesPayload(const v1::Envelope& envelope) { return envelope.has_chunk() || envelope.has_put_chunk(); }

Status ValidatePayload(const v1::Envelope& envelope, std::optional<std::size_t> bytes) {
  if (CarriesPayload(envelope) != bytes.has_value()) {
    return Corrupt(bytes ? "a message with a frame too many" : "a chunk without the frame of its bytes");
  }
  if (!bytes) return {};
  if (*bytes > kChunkBytesMax) return Bad("the chunk", fmt::format("{} bytes long", *bytes), fmt::format("at most {}", kChunkBytesMax));
  const v1::PutChunk& put = envelope.put_chunk();
  if (envelope.has_put_chunk() && *bytes > put.bytes() - put.offset()) {
    return Bad("the chunk", fmt::format("{} bytes long at offset {}", *bytes, put.offset()),
               fmt::format("within the artefact's {} bytes", put.bytes()));
  }
  return {};
}

}  // namespace trem
