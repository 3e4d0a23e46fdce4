#pragma once

#include <vector>

#include "mosaic/base/status.h"
#include "proto/trem/v1/job.pb.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// The spec of recording `index` of a sortie as if it were the only one: 0 is the sortie's own source, the others are those of Sortie.more.
v1::Sortie SortieOfRecording(const v1::Sortie& sortie, int index);

struct MergedRecordings {
  v1::SortieManifest all;                 // The frames of all recordings, one after the other.
  std::vector<v1::SortieManifest> parts;  // What the ENHANCE tasks of each recording read; see RecordingManifest.
};

// Of the manifests of a sortie's recordings, in order (one at least). The parts hold what ENHANCE needs and nothing that changes with the
// mosaic that is asked for, nor with a recording after their own. kInvalidInput when frame sizes or number types differ, and of
// AttachGround.
Result<MergedRecordings> MergeRecordings(const v1::Sortie& sortie, const std::vector<v1::SortieManifest>& recordings);

}  // namespace trem
