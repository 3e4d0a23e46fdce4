#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "proto/trem/v1/job.pb.h"
#include "proto/trem/v1/task.pb.h"
#include "worker/sortie/telemetry_csv.h"
#include "worker/telemetry/telemetry_audit.h"
#include "worker/telemetry/utc_clock.h"

namespace trem {

// The telemetry that a sortie uses, before its frames are known.
struct FoundTelemetry {
  v1::TelemetrySource source = v1::TELEMETRY_NONE;
  std::string path;                     // Of the file that it is in.
  std::optional<TelemetryTable> table;  // TELEMETRY_CSV and TELEMETRY_EXIF: rows by frame...
  TelemetryAudit audit;                 // ... every other source: poses by time. EXIF has this too.
  UtcClock utc;                         // On the audit's times.
  // Seconds per unit of the frames' pts, when the audit's times are on the container's clock; 0: they are on the frames' own.
  double time_base_s = 0.0;
  std::vector<v1::Note> notes;  // What was found and left, and why.
};

// Files beside a video that bear its name and the extension of a track (.srt, .gpx), in the order in which they are tried.
std::vector<std::filesystem::path> TrackFilesBeside(const v1::Sortie& sortie);

// Looks for telemetry in this order and takes the first that is usable: telemetry.path (.srt, .gpx, anything else a telemetry.csv);
// telemetry.csv in the source's folder or (for images) its parent; of a video, KLV in its data streams, then a file of its name with the
// extension .srt or .gpx; of images, EXIF and XMP. Nothing (TELEMETRY_NONE, with notes) when there is none or telemetry.ignore is set.
// `width_px`, `height_px`: of the frames.
// kInvalidInput and the like only for a file that the user named, a telemetry.csv or an elevation model that does not cover the place:
// telemetry that was found by itself and cannot be used is left with a warning.
Result<FoundTelemetry> FindTelemetry(const v1::Sortie& sortie, int width_px, int height_px);

}  // namespace trem
