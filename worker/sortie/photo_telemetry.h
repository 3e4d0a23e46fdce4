#pragma once

#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "proto/trem/v1/task.pb.h"
#include "worker/telemetry/telemetry_record.h"

namespace trem {

// EXIF and XMP of the images of a folder or glob.
struct PhotoTelemetry {
  std::vector<std::string> names;        // Of the images with metadata that say where they were taken, in natural order.
  std::vector<TelemetryRecord> records;  // One for each name; time_s is its number.
  std::vector<double> times_s;           // Since the first, where every one has a time of its own that is later than the one's before.
  std::vector<v1::Note> notes;
};

// Reads headers only. Nothing when none of the first 8 images that could be read says where it was taken. Errors of ListImages.
Result<PhotoTelemetry> ReadPhotoTelemetry(const std::string& source_path, int width_px, int height_px);

}  // namespace trem
