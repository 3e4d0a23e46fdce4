// Goal: no bytes that call themselves KLV crash the reader or make it keep more than they hold, whatever pieces they come in; records hold
// numbers of sense. Method: the first byte says how the rest is cut.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>

#include "worker/telemetry/klv_stream.h"
#include "worker/telemetry/telemetry_audit.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 2) return 0;
  const std::size_t piece = 1 + 8 * static_cast<std::size_t>(data[0]);
  trem::KlvStreamReader reader;
  double pts_s = 0.0;
  for (std::size_t at = 1; at < size; at += piece) {
    reader.Feed({data + at, std::min(piece, size - at)}, data[0] % 2 == 0 ? std::optional<double>(pts_s) : std::nullopt);
    pts_s += 0.04;
  }
  const trem::KlvStreamContent content = reader.Finish();
  if (content.records.size() > size / 17 || content.pts_s.size() != content.records.size()) std::abort();
  double last_s = -1e300;
  for (const trem::TelemetryRecord& record : content.records) {
    if (!(record.time_s > last_s)) std::abort();
    last_s = record.time_s;
    if (record.sensor.has_value() && !(std::abs(record.sensor->latitude_deg) <= 90.0 && std::abs(record.sensor->longitude_deg) <= 180.0))
      std::abort();
    if (record.hfov_deg.has_value() && !(*record.hfov_deg > 0.0 && *record.hfov_deg < 180.0)) std::abort();
  }
  const trem::TelemetryAudit audit = trem::AuditTelemetry(content.records, {});
  for (const trem::CameraSample& pose : audit.poses) {
    if (!std::isfinite(pose.yaw_deg) || !(std::abs(pose.pitch_deg) <= 90.0 + 1e-9)) std::abort();
  }
  if (audit.explanation.empty()) std::abort();
  return 0;
}
