#include <string>

#include "mosaic/raster/crs.h"
#include "proto/codec/convert.h"
#include "worker/sortie/ingest.h"
#include "worker/tasks/describe_sortie.h"
#include "worker/tasks/task.h"

namespace trem {

Result<v1::TaskResult> RunIngestTask(const v1::TaskSpec& spec, const TaskContext& context) {
  TREM_CHECK(context.store != nullptr);
  // Needed by ALIGN only, but a wrong one should be reported before hours of ENHANCE.
  const std::string& crs = spec.sortie().mosaic().crs();
  if (!crs.empty()) TREM_RETURN_IF_ERROR(UtmFrame::ForCrs(crs).status().WithPrefix("mosaic.crs"));
  TREM_ASSIGN_OR_RETURN(const v1::SortieManifest manifest, DescribeSortie(spec.sortie(), context.progress));
  v1::TaskResult result;
  TREM_ASSIGN_OR_RETURN(*result.add_outputs(), PutProtoArtefact(*context.store, "manifest.pb", manifest));
  *result.mutable_ingest() = SummariseManifest(manifest);
  *result.mutable_notes() = manifest.notes();
  return result;
}

}  // namespace trem
