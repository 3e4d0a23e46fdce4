// Goal: no bytes that call themselves a photograph crash the reader of EXIF and XMP, and no exception of its library gets out.
#include <cmath>
#include <cstdint>
#include <cstdlib>

#include "worker/telemetry/photo_metadata.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto metadata = trem::ParsePhotoMetadata({data, size}, "photo", 400, 300);
  if (!metadata.ok()) return metadata.status().message().find("photo") == std::string::npos ? std::abort(), 0 : 0;
  const trem::TelemetryRecord& record = metadata->record;
  if (record.sensor.has_value() && !(std::abs(record.sensor->latitude_deg) <= 90.0 && std::abs(record.sensor->longitude_deg) <= 180.0))
    std::abort();
  if (record.hfov_deg.has_value() && !(*record.hfov_deg > 0.0 && *record.hfov_deg < 180.0)) std::abort();
  for (const auto& value : {record.altitude_msl_m, record.sensor_azimuth_deg, record.sensor_elevation_deg, record.sensor_roll_deg}) {
    if (value.has_value() && !std::isfinite(*value)) std::abort();
  }
  return 0;
}
