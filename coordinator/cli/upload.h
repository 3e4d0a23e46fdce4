#pragma once

#include <memory>

#include "mosaic/base/artefact_store.h"
#include "mosaic/base/status.h"
#include "proto/trem/v1/job.pb.h"

namespace trem {

// Brings every file that the sortie needs - the source, telemetry that lies beside it, whatever the spec names - to the artefact store
// behind `backing`, and returns the sortie with paths into that upload. Paths of GDAL's (/vsis3/...) stay as they are. Sending the same
// files again sends nothing: they are there already. Errors: kInvalidInput for a glob over several folders.
Result<v1::Sortie> UploadSortie(const v1::Sortie& sortie, const std::shared_ptr<ArtefactBacking>& backing);

}  // namespace trem
