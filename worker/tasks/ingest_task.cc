#include <string>

#include "proto/codec/convert.h"
#include "worker/sortie/ingest.h"
#include "worker/tasks/task.h"

namespace trem {

Result<v1::TaskResult> RunIngestTask(const v1::TaskSpec& spec, const TaskContext& context) {
  TREM_CHECK(context.store != nullptr);
  TREM_ASSIGN_OR_RETURN(const v1::SortieManifest manifest, IngestSortie(spec.sortie(), context.progress));
  v1::TaskResult result;
  TREM_ASSIGN_OR_RETURN(*result.add_outputs(), PutProtoArtefact(*context.store, "manifest.pb", manifest));
  *result.mutable_ingest() = SummariseManifest(manifest);
  *result.mutable_notes() = manifest.notes();
  return result;
}

}  // namespace trem
