#include "tests/bench/no_op_task.h"

#include <string>

#include "coordinator/planning/task_plan.h"
#include "mosaic/base/digest.h"

namespace trem::bench {

v1::TaskResult NoOpResult(const v1::TaskSpec& spec, std::uint32_t window_count) {
  v1::TaskResult result;
  const auto add = [&](const std::string& name) {
    v1::ArtefactRef* output = result.add_outputs();
    output->set_name(name);
    output->set_sha256(Sha256Hex(spec.key() + name));
    output->set_bytes(100'000);
  };
  const std::string main = MainArtefactName(spec.kind());
  add(main.empty() ? "mosaic.tif" : main);
  if (spec.kind() == v1::ENHANCE) {
    for (const char* scene : {"scene-000.tif", "scene-001.tif", "scene-002.tif", "scene-003.tif"}) add(scene);
  }
  if (spec.kind() == v1::INGEST) {
    const std::uint32_t frames = window_count / 2 * 8 + 2;
    v1::IngestSummary* ingest = result.mutable_ingest();
    ingest->set_frame_count(frames);
    ingest->set_usable_frame_count(frames);
    ingest->set_width_px(110);
    ingest->set_height_px(50);
    ingest->mutable_valid_roi()->set_x1(110);
    ingest->mutable_valid_roi()->set_y1(50);
    ingest->add_spans()->set_end(frames);
  }
  if (spec.kind() == v1::ALIGN) {
    result.mutable_align()->set_tile_count(window_count / 10);
    for (std::uint32_t tile = 0; tile < window_count / 10; ++tile) result.mutable_align()->add_tiles()->add_window_ids(tile);
  }
  return result;
}

}  // namespace trem::bench
