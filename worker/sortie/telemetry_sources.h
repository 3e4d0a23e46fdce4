#pragma once

#include <optional>
#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "proto/trem/v1/job.pb.h"
#include "proto/trem/v1/task.pb.h"
#include "worker/sortie/telemetry_csv.h"
#include "worker/telemetry/telemetry_audit.h"

namespace trem {

// The telemetry that a sortie uses, before its frames are known.
struct FoundTelemetry {
  v1::TelemetrySource source = v1::TELEMETRY_NONE;
  std::string path;                     // Of the file that it is in.
  std::optional<TelemetryTable> table;  // TELEMETRY_CSV.
  TelemetryAudit audit;                 // Every other source.
  // Seconds per unit of the frames' pts, when the audit's times are on the container's clock; 0: they are on the frames' own.
  double time_base_s = 0.0;
  std::vector<v1::Note> notes;  // What was found and left, and why.
};

// Looks for telemetry in this order and takes the first that is usable: telemetry.path; telemetry.csv in the source's folder or (for
// images) its parent; KLV in the video's data streams. Nothing (TELEMETRY_NONE, with notes) when there is none or telemetry.ignore is set.
// kInvalidInput and the like only for a file that the user named or a telemetry.csv: telemetry inside the recording that cannot be used
// is left with a warning.
Result<FoundTelemetry> FindTelemetry(const v1::Sortie& sortie, double aspect);

// Gives the frames of `manifest` poses and corners at their times. Adds the notes.
Status AttachFoundTelemetry(const FoundTelemetry& found, const v1::Sortie& sortie, v1::SortieManifest* manifest);

}  // namespace trem
