#pragma once

#include <optional>
#include <string>

#include "mosaic/base/status.h"
#include "proto/trem/v1/job.pb.h"
#include "proto/trem/v1/task.pb.h"
#include "worker/sortie/telemetry_csv.h"

namespace trem {

// The telemetry.csv of a sortie: telemetry.path when set, else `telemetry.csv` in the source's folder or (for images) its parent.
// Nothing when there is none or telemetry.ignore is set.
std::optional<std::string> FindTelemetryCsv(const v1::Sortie& sortie);

// Gives the frames of `manifest` (whose names, numbers and, for video, times are set) what `table` knows about them:
//  - rows are matched by file name with or without extension or, when no row names a file (or for video), by frame number;
//  - images get the rows' times; times of frames between are interpolated; times since 1970 are also the frames' UTC;
//  - poses and corners; frames between two matched ones at most 5 s apart get linearly interpolated ones (angles along the shorter arc);
//  - the ground elevation: of `spec` when set, else the median of the rows, else 0.
// Adds notes about rows and frames without a partner and about suspicious values. kInvalidInput when no row matches any frame.
Status AttachTelemetry(const TelemetryTable& table, const std::string& path, const v1::Telemetry& spec, v1::SortieManifest* manifest);

}  // namespace trem
