#pragma once

#include "mosaic/base/status.h"
#include "proto/trem/v1/job.pb.h"
#include "proto/trem/v1/task.pb.h"
#include "worker/sortie/telemetry_sources.h"

namespace trem {

// Gives the frames of `manifest` (with their times, sizes and motions) poses and corners at their times, and the ground; adds the notes.
// For sources with times of their own the offset between their clock and the frames' is telemetry.time_offset_s or, when that is not set,
// estimated from the image motion (EstimateTimeOffset). Errors of AttachTelemetry and AttachGround.
Status AttachFoundTelemetry(const FoundTelemetry& found, const v1::Sortie& sortie, v1::SortieManifest* manifest);

}  // namespace trem
