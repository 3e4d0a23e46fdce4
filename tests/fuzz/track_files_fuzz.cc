// Goal: no bytes that call themselves a DJI subtitle file or a GPX track crash their parsers, and what they accept has places on Earth in
// the order of time. Method: the first byte chooses the format.
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "worker/telemetry/track_files.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 1) return 0;
  const std::string_view text(reinterpret_cast<const char*>(data) + 1, size - 1);
  const bool srt = data[0] % 2 == 0;
  auto records = srt ? trem::ParseDjiSrt(text, "track", 1.5) : trem::ParseGpx(text, "track");
  if (!records.ok()) {
    if (records.status().message().find("track") == std::string::npos) std::abort();
    return 0;
  }
  if (records->empty()) std::abort();
  double last_s = -1.0;
  for (const trem::TelemetryRecord& record : *records) {
    if (!(record.time_s > last_s)) std::abort();
    last_s = record.time_s;
    if (!record.sensor.has_value() || !(std::abs(record.sensor->latitude_deg) <= 90.0 && std::abs(record.sensor->longitude_deg) <= 180.0))
      std::abort();
    if (record.hfov_deg.has_value() && !(*record.hfov_deg > 0.0 && *record.hfov_deg < 180.0)) std::abort();
  }
  trem::FixedPointing fixed;
  fixed.pitch_deg = -90.0;
  if (records->size() < 200) trem::FillPointing(fixed, &*records);
  return 0;
}
