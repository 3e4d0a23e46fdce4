#pragma once

#include <functional>

#include "mosaic/base/status.h"
#include "proto/trem/v1/job.pb.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// Reads the source of `sortie` once, frame by frame (memory: a few frames, of as many pixels as two of 4096 x 4096), and describes it:
// frames and their states, times, the motion from each frame to the next, black borders, grey scaling, noise, telemetry, and the spans that
// windows may lie in. Notes tell what a user should know. The same source and spec give the same manifest, bit by bit, for any number of
// threads.
//
// `progress` is called at every frame with the fraction done; false: stop, kCancelled. kNotFound and kInvalidInput name the path and what
// is wrong with it: no readable frame, telemetry that cannot be parsed or matches nothing, ...
Result<v1::SortieManifest> IngestSortie(const v1::Sortie& sortie, const std::function<bool(double fraction)>& progress, int threads = 1);

// What planning needs of a manifest.
v1::IngestSummary SummariseManifest(const v1::SortieManifest& manifest);

}  // namespace trem
