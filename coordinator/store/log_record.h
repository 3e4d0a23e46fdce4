#pragma once

#include <string>
#include <string_view>

#include "mosaic/base/status.h"
#include "proto/trem/v1/events.pb.h"

namespace trem {

// One event as it stands in the log.
std::string EncodeLogRecord(const v1::LogEvent& event);

// kCorrupt, saying what is wrong, when the bytes are no event that this program could have written: too long, not a message, of an unknown
// kind, or with a task key, attempt, status or task kind that none has.
Result<v1::LogEvent> DecodeLogRecord(std::string_view bytes);

// The name of the event in trem.v1.LogEvent: only for people who look into the log.
std::string KindOfLogRecord(const v1::LogEvent& event);

}  // namespace trem
