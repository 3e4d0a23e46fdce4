// Feeds arbitrary bytes to the decoder of the coordinator's log: as one record, and as a row of records (2 bytes of length before each)
// that a scheduler restores its state from. What is accepted must be encodable again to a record that decodes to the same bytes; what
// cannot be restored must be refused, not crash.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "coordinator/scheduling/scheduler.h"
#include "coordinator/store/log_record.h"
#include "mosaic/base/check.h"

namespace {

void RestoreAll(std::string_view bytes) {
  trem::Scheduler scheduler;
  while (bytes.size() >= 2) {
    const std::size_t size = static_cast<unsigned char>(bytes[0]) + 256U * static_cast<unsigned char>(bytes[1]);
    bytes.remove_prefix(2);
    const auto event = trem::DecodeLogRecord(bytes.substr(0, size));
    bytes.remove_prefix(std::min(size, bytes.size()));
    if (event.ok() && !scheduler.Restore(*event).ok()) return;
  }
  (void)scheduler.Snapshot();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  if (const auto event = trem::DecodeLogRecord(bytes); event.ok()) {
    const std::string record = trem::EncodeLogRecord(*event);
    const auto again = trem::DecodeLogRecord(record);
    TREM_CHECK(again.ok() && trem::EncodeLogRecord(*again) == record);
  }
  RestoreAll(bytes);
  return 0;
}
