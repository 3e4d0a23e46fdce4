#pragma once

#include <string>
#include <vector>

#include "mosaic/base/artefact_store.h"
#include "mosaic/base/status.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// After a task has failed with kCorrupt or kNotFound: digests of the artefacts it reads (its inputs, and the scene rasters that its windows
// name) that are missing or have other bytes than their digest says, sorted. Empty for other failures, and when the fault lies elsewhere.
std::vector<std::string> FindBadArtefacts(const v1::TaskSpec& spec, const Status& failure, const ArtefactStore& store);

}  // namespace trem
