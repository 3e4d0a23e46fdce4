// Goal: no bytes that call themselves telemetry.csv crash the parser, and what it accepts keeps its promises.
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "worker/sortie/telemetry_csv.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto table = trem::ParseTelemetryCsv({reinterpret_cast<const char*>(data), size}, "telemetry.csv");
  if (!table.ok()) {
    if (table.status().message().find("telemetry.csv") == std::string::npos) std::abort();
    return 0;
  }
  if (table->rows.empty() || (!table->has_pose && !table->has_corners)) std::abort();
  for (const trem::TelemetryRow& row : table->rows) {
    if (row.frame.empty()) std::abort();
    if (row.pose.has_value() && !(std::abs(row.pose->latitude_deg) <= 90.0 && std::abs(row.pose->pitch_deg) <= 90.0)) std::abort();
  }
  return 0;
}
