#include "worker/app/done_message.h"

#include <sys/resource.h>

#include <nlohmann/json.hpp>
#include <string>

#include "proto/codec/envelope.h"

namespace trem {
namespace {

constexpr std::size_t kTextBytesMax = 4096;

std::uint64_t PeakMemoryBytes() {
  rusage usage{};
  return ::getrusage(RUSAGE_SELF, &usage) == 0 ? static_cast<std::uint64_t>(usage.ru_maxrss) * 1024 : 0;
}

void SetFailure(const Status& status, v1::Done* done) {
  done->clear_result();
  done->set_status_code(static_cast<std::uint32_t>(status.code()));
  done->set_message(ToMessageText(status.message()));
}

}  // namespace

std::string ToMessageText(const std::string& text) {
  using nlohmann::json;
  const std::string quoted = json(text.substr(0, kTextBytesMax)).dump(-1, ' ', false, json::error_handler_t::replace);
  return json::parse(quoted).get<std::string>();
}

v1::Envelope MakeDone(const v1::TaskAttempt& attempt, const ComputeThread::Finished& finished) {
  v1::Envelope envelope;
  v1::Done* done = envelope.mutable_done();
  *done->mutable_attempt() = attempt;
  done->set_elapsed_ms(static_cast<std::uint64_t>(finished.elapsed.count()));
  const TaskOutcome& outcome = finished.outcome;
  done->set_peak_memory_bytes(outcome.peak_memory_bytes > 0 ? outcome.peak_memory_bytes : PeakMemoryBytes());
  if (!outcome.result.ok()) {
    SetFailure(outcome.result.status(), done);
    for (const std::string& digest : outcome.bad_artefacts) done->add_bad_artefacts(digest);
    return envelope;
  }
  *done->mutable_result() = *outcome.result;
  for (v1::Note& note : *done->mutable_result()->mutable_notes()) {
    note.set_subject(ToMessageText(note.subject()));
    note.set_message(ToMessageText(note.message()));
  }
  if (const Status valid = ValidateEnvelope(envelope); !valid.ok()) {
    SetFailure(Failed("the task's result cannot be sent: " + valid.message()), done);
  }
  return envelope;
}

}  // namespace trem
