#include "worker/sortie/photo_telemetry.h"

#include <fmt/format.h>

#include "worker/sortie/frame_source.h"
#include "worker/sortie/image_sequence_reader.h"
#include "worker/telemetry/photo_metadata.h"

namespace trem {
namespace {

constexpr int kLookedAtFirst = 8;

// Seconds since the first record; empty when some record has no time, or none later than the one's before.
std::vector<double> TimesOf(const std::vector<TelemetryRecord>& records) {
  std::vector<double> times_s;
  for (const TelemetryRecord& record : records) {
    if (!record.utc_us.has_value()) return {};
    const double time_s = 1e-6 * static_cast<double>(*record.utc_us - *records.front().utc_us);
    if (!times_s.empty() && time_s <= times_s.back()) return {};
    times_s.push_back(time_s);
  }
  return times_s;
}

}  // namespace

Result<PhotoTelemetry> ReadPhotoTelemetry(const std::string& source_path, int width_px, int height_px) {
  TREM_ASSIGN_OR_RETURN(const ImageList list, ListImages(source_path));
  PhotoTelemetry telemetry;
  std::string camera;
  int magnetic = 0;
  int looked_at = 0;
  bool cropped = false;
  for (const std::string& name : list.names) {
    if (telemetry.names.empty() && looked_at == kLookedAtFirst) break;
    // A damaged header is the frame reader's to report.
    const Result<PhotoMetadata> metadata = ReadPhotoMetadata((list.folder / name).string(), width_px, height_px);
    if (!metadata.ok()) continue;
    ++looked_at;
    if (!metadata->record.sensor.has_value()) continue;
    TelemetryRecord record = metadata->record;
    record.time_s = static_cast<double>(telemetry.names.size());
    telemetry.names.push_back(name);
    telemetry.records.push_back(record);
    if (camera.empty()) camera = metadata->camera;
    magnetic += metadata->from_magnetic_north ? 1 : 0;
    cropped = cropped || metadata->field_of_view_from_crop;
  }
  if (telemetry.names.empty()) return telemetry;
  telemetry.times_s = TimesOf(telemetry.records);
  telemetry.notes.push_back(MakeNote(v1::INFO, "exif", source_path,
                                     fmt::format("{} of {} images say in their EXIF or XMP where they were taken{}", telemetry.names.size(),
                                                 list.names.size(), camera.empty() ? "" : " (" + camera + ")")));
  if (magnetic > 0) {
    telemetry.notes.push_back(
        MakeNote(v1::WARNING, "exif_magnetic_north", source_path,
                 fmt::format("the direction of {} images is from magnetic north and is taken for true north", magnetic)));
  }
  if (cropped) {
    telemetry.notes.push_back(
        MakeNote(v1::INFO, "exif_field_of_view", source_path,
                 "the field of view follows from the 35 mm equivalent focal length, the pictures taken for the full width of "
                 "a 4:3 sensor; telemetry.hfov_deg overrules that"));
  }
  return telemetry;
}

}  // namespace trem
