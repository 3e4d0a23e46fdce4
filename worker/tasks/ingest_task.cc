#include <string>
#include <utility>
#include <vector>

#include "mosaic/raster/crs.h"
#include "proto/codec/convert.h"
#include "worker/sortie/ingest.h"
#include "worker/tasks/describe_sortie.h"
#include "worker/tasks/merge_recordings.h"
#include "worker/tasks/task.h"

namespace trem {

Result<v1::TaskResult> RunIngestTask(const v1::TaskSpec& spec, const TaskContext& context) {
  TREM_CHECK(context.store != nullptr);
  // Needed by ALIGN only, but a wrong one should be reported before hours of ENHANCE.
  const std::string& crs = spec.sortie().mosaic().crs();
  if (!crs.empty()) TREM_RETURN_IF_ERROR(UtmFrame::ForCrs(crs).status().WithPrefix("mosaic.crs"));
  const int count = 1 + spec.sortie().more_size();
  std::vector<v1::SortieManifest> recordings;
  for (int k = 0; k < count; ++k) {
    const auto progress = [&](double fraction) { return !context.progress || context.progress((k + fraction) / count); };
    Result<v1::SortieManifest> manifest = DescribeSortie(SortieOfRecording(spec.sortie(), k), progress, context.threads);
    if (!manifest.ok()) return k == 0 ? manifest.status() : manifest.status().WithPrefix("more[" + std::to_string(k - 1) + "]");
    recordings.push_back(std::move(*manifest));
  }
  TREM_ASSIGN_OR_RETURN(const MergedRecordings merged, MergeRecordings(spec.sortie(), recordings));
  v1::TaskResult result;
  TREM_ASSIGN_OR_RETURN(*result.add_outputs(), PutProtoArtefact(*context.store, "manifest.pb", merged.all));
  *result.mutable_ingest() = SummariseManifest(merged.all);
  *result.mutable_notes() = merged.all.notes();
  std::uint32_t frame_begin = 0;
  for (std::size_t k = 0; k < merged.parts.size(); ++k) {
    TREM_ASSIGN_OR_RETURN(*result.add_outputs(), PutProtoArtefact(*context.store, "recording.pb", merged.parts[k]));
    result.mutable_ingest()->add_recording_begins(frame_begin);
    frame_begin += static_cast<std::uint32_t>(recordings[k].frames_size());
  }
  return result;
}

}  // namespace trem
