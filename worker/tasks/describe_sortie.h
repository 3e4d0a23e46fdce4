#pragma once

#include <functional>

#include "mosaic/base/status.h"
#include "proto/trem/v1/job.pb.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// What INGEST finds: IngestSortie's manifest, and of the sensor what needs the generative model: the kernel file's content, the estimated
// width of the PSF, the resolution ceiling. Sensor files are read first: a bad one should be reported before an hour of decoding. Errors
// and `progress` as IngestSortie.
Result<v1::SortieManifest> DescribeSortie(const v1::Sortie& sortie, const std::function<bool(double fraction)>& progress, int threads = 1);

}  // namespace trem
