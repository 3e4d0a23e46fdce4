#include "coordinator/planning/task_plan.h"

#include "coordinator/planning/memory_estimate.h"
#include "mosaic/base/check.h"
#include "mosaic/base/digest.h"
#include "mosaic/base/version.h"
#include "proto/codec/convert.h"

namespace trem {
namespace {

std::uint64_t SplitMix64(std::uint64_t state) {
  std::uint64_t z = state + 0x9e3779b97f4a7c15ULL;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
  return z ^ (z >> 31);
}

void AddWindows(const JobInputs& inputs, v1::TaskSpec* spec) {
  TREM_CHECK(inputs.window_pbs.size() == inputs.windows.size());
  for (const v1::ArtefactRef& window : inputs.window_pbs) *spec->add_inputs() = window;
}

void FillEnhance(const JobInputs& inputs, std::uint32_t index, v1::TaskSpec* spec) {
  TREM_CHECK(index < inputs.windows.size());
  const WindowPlan& window = inputs.windows[index];
  *spec->add_inputs() = inputs.manifest;
  spec->mutable_enhance()->set_window_id(window.window_id);
  *spec->mutable_enhance()->mutable_roi_in_sensor() = ToProto(window.roi_in_sensor);
  spec->mutable_enhance()->set_frame_begin(window.frame_begin);
  spec->mutable_enhance()->set_frame_end(window.frame_end);
  spec->set_memory_bytes(EnhanceMemoryBytes(inputs.sortie, inputs.ingest.width_px(), inputs.ingest.height_px(), window));
}

}  // namespace

v1::TaskSpec PlanTask(const JobInputs& inputs, v1::TaskKind kind, std::uint32_t index) {
  v1::TaskSpec spec;
  spec.set_kind(kind);
  *spec.mutable_sortie() = inputs.sortie;
  spec.set_seed(TaskSeed(inputs.sortie.seed(), kind, index));
  switch (kind) {
    case v1::INGEST:
      spec.set_memory_bytes(IngestMemoryBytes());
      break;
    case v1::ENHANCE:
      FillEnhance(inputs, index, &spec);
      break;
    case v1::ALIGN:
      *spec.add_inputs() = inputs.manifest;
      AddWindows(inputs, &spec);
      spec.set_memory_bytes(AlignMemoryBytes(inputs.ingest, inputs.window_pb_bytes));
      break;
    case v1::COMPOSITE:
      TREM_CHECK(index < inputs.align.tile_count());
      *spec.add_inputs() = inputs.alignment;
      AddWindows(inputs, &spec);
      spec.mutable_composite()->set_tile_index(index);
      spec.set_memory_bytes(CompositeMemoryBytes(inputs.sortie, inputs.window_pb_bytes));
      break;
    case v1::EXPORT:
      TREM_CHECK(inputs.tiles.size() == inputs.align.tile_count());
      *spec.add_inputs() = inputs.alignment;
      *spec.add_inputs() = inputs.manifest;
      AddWindows(inputs, &spec);
      for (const v1::ArtefactRef& tile : inputs.tiles) *spec.add_inputs() = tile;
      spec.set_memory_bytes(ExportMemoryBytes(inputs.window_pb_bytes));
      break;
    default:
      TREM_CHECK_MSG(false, "task kind " + std::to_string(kind));
  }
  spec.set_key(TaskKey(spec, inputs.job_id));
  return spec;
}

std::string TaskKey(const v1::TaskSpec& spec, const std::string& job_id) {
  std::string bytes;
  if (spec.key().empty()) {
    bytes = SerializeDeterministic(spec);
  } else {
    v1::TaskSpec keyless = spec;
    keyless.clear_key();
    bytes = SerializeDeterministic(keyless);
  }
  bytes += kEngineRevision;
  if (spec.kind() == v1::INGEST) bytes += "\njob " + job_id;
  return Sha256Hex(bytes);
}

std::uint64_t TaskSeed(std::uint64_t sortie_seed, v1::TaskKind kind, std::uint32_t index) {
  return SplitMix64(SplitMix64(SplitMix64(sortie_seed) ^ static_cast<std::uint64_t>(kind)) ^ index);
}

std::string MainArtefactName(v1::TaskKind kind) {
  switch (kind) {
    case v1::INGEST:
      return "manifest.pb";
    case v1::ENHANCE:
      return "window.pb";
    case v1::ALIGN:
      return "alignment.pb";
    case v1::COMPOSITE:
      return "tile.tif";
    default:
      return "";
  }
}

std::string TaskTitle(v1::TaskKind kind, std::uint32_t index) {
  const std::string name = v1::TaskKind_IsValid(kind) ? v1::TaskKind_Name(kind) : std::to_string(kind);
  if (kind == v1::ENHANCE) return name + " window " + std::to_string(index);
  if (kind == v1::COMPOSITE) return name + " tile " + std::to_string(index);
  return name;
}

Status CheckTaskResult(v1::TaskKind kind, const v1::TaskResult& result) {
  const std::string name = v1::TaskKind_Name(kind);
  const std::string main = MainArtefactName(kind);
  if (result.outputs().empty()) return Failed("the result of an " + name + " task has no outputs");
  if (!main.empty() && result.outputs(0).name() != main) {
    return Failed("the first output of an " + name + " task is '" + result.outputs(0).name() + "'; expected '" + main + "'");
  }
  for (const v1::ArtefactRef& output : result.outputs()) {
    if (!IsSha256Hex(output.sha256())) {
      return Failed("output '" + output.name() + "' of an " + name + " task has digest '" + output.sha256() +
                    "'; expected 64 hexadecimal digits");
    }
  }
  if (kind == v1::INGEST && !result.has_ingest()) return Failed("the result of an INGEST task has no summary");
  if (kind == v1::ALIGN && (!result.has_align() || result.align().tile_count() == 0)) {
    return Failed("the result of an ALIGN task has no mosaic tile");
  }
  return {};
}

}  // namespace trem
