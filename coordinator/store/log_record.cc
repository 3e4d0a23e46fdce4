#include "coordinator/store/log_record.h"

#include "mosaic/base/check.h"
#include "mosaic/base/digest.h"
#include "proto/codec/convert.h"
#include "proto/codec/envelope.h"

namespace trem {
namespace {

// A result lists an artefact per scene: far less than this. Protobuf itself stops at 2 GiB.
constexpr std::size_t kRecordBytesMax = 256U << 20;

Status CheckKey(const std::string& key) {
  if (IsSha256Hex(key)) return {};
  return Corrupt("its task_key is '" + key.substr(0, 64) + "'; expected 64 lower-case hexadecimal digits");
}

Status CheckFailure(std::uint32_t code) {
  if (code > static_cast<std::uint32_t>(StatusCode::kOk) && code <= static_cast<std::uint32_t>(StatusCode::kFailed)) return {};
  return Corrupt("its status_code is " + std::to_string(code) + "; expected that of a failure");
}

Status CheckJob(const std::string& job_id) {
  if (IsJobId(job_id)) return {};
  return Corrupt("its job_id is '" + job_id.substr(0, 64) + "'; expected 1 to 64 of a-z, 0-9 and '-'");
}

Status CheckCommitted(const v1::TaskCommitted& committed) {
  if (!v1::TaskKind_IsValid(committed.kind()) || committed.kind() == v1::TASK_KIND_UNSPECIFIED) {
    return Corrupt("its kind is " + std::to_string(committed.kind()) + "; expected INGEST to EXPORT");
  }
  return CheckKey(committed.task_key());
}

Status Check(const v1::LogEvent& event) {
  switch (event.body_case()) {
    case v1::LogEvent::kJobSubmitted:
      return event.job_submitted().has_sortie() ? CheckJob(event.job_submitted().job_id()) : Corrupt("it has no sortie");
    case v1::LogEvent::kJobRemoved:
      return CheckJob(event.job_removed().job_id());
    case v1::LogEvent::kJobCancelled:
      return CheckJob(event.job_cancelled().job_id());
    case v1::LogEvent::kJobFailed:
      TREM_RETURN_IF_ERROR(CheckFailure(event.job_failed().status_code()));
      return CheckJob(event.job_failed().job_id());
    case v1::LogEvent::kTaskCommitted:
      return CheckCommitted(event.task_committed());
    case v1::LogEvent::kAttemptStarted:
      return CheckKey(event.attempt_started().task_key());
    case v1::LogEvent::kResultDiffered:
      return CheckKey(event.result_differed().task_key());
    case v1::LogEvent::kTaskQuarantined:
      TREM_RETURN_IF_ERROR(CheckFailure(event.task_quarantined().status_code()));
      TREM_RETURN_IF_ERROR(CheckJob(event.task_quarantined().job_id()));
      return CheckKey(event.task_quarantined().task_key());
    case v1::LogEvent::kTaskInvalidated:
      return CheckKey(event.task_invalidated().task_key());
    case v1::LogEvent::BODY_NOT_SET:
      break;
  }
  return Corrupt("it is not a trem.v1.LogEvent of a kind that this version knows");
}

}  // namespace

std::string EncodeLogRecord(const v1::LogEvent& event) { return SerializeDeterministic(event); }

Result<v1::LogEvent> DecodeLogRecord(std::string_view bytes) {
  if (bytes.size() > kRecordBytesMax) {
    return Corrupt("it has " + std::to_string(bytes.size()) + " bytes; expected at most " + std::to_string(kRecordBytesMax));
  }
  v1::LogEvent event;
  if (!event.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) return Corrupt("it is not a trem.v1.LogEvent");
  TREM_RETURN_IF_ERROR(Check(event));
  return event;
}

std::string KindOfLogRecord(const v1::LogEvent& event) {
  const auto* field = v1::LogEvent::descriptor()->FindFieldByNumber(static_cast<int>(event.body_case()));
  TREM_CHECK_MSG(field != nullptr, "an empty LogEvent");
  return field->name();
}

}  // namespace trem
