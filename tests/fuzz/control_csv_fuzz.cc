// Goal: no bytes that call themselves gcp.csv crash the parser, and what it accepts keeps its promises.
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "worker/sortie/control_csv.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto rows = trem::ParseControlCsv({reinterpret_cast<const char*>(data), size}, "gcp.csv");
  if (!rows.ok()) {
    if (rows.status().message().find("gcp.csv") == std::string::npos) std::abort();
    return 0;
  }
  if (rows->empty()) std::abort();
  for (const trem::ControlRow& row : *rows) {
    if (row.name.empty() || row.frame.empty() || !(std::abs(row.latitude_deg) <= 90.0) || !std::isfinite(row.x_px)) std::abort();
  }
  return 0;
}
