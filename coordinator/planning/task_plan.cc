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

constexpr std::uint32_t kTilesMax = 1'000'000;
constexpr const char* kWindowName = "window.pb";

bool IsHole(const v1::ArtefactRef& ref) { return ref.sha256().empty(); }

void AddAll(const std::vector<v1::ArtefactRef>& refs, v1::TaskSpec* spec) {
  for (const v1::ArtefactRef& ref : refs) {
    if (!IsHole(ref)) *spec->add_inputs() = ref;
  }
}

// The windows that reach tile `index`, without holes.
std::vector<v1::ArtefactRef> WindowsOfTile(const JobInputs& inputs, std::uint32_t index) {
  TREM_CHECK(index < static_cast<std::uint32_t>(inputs.align.tiles_size()));
  std::vector<v1::ArtefactRef> windows;
  for (const std::uint32_t window_id : inputs.align.tiles(static_cast<int>(index)).window_ids()) {
    TREM_CHECK(window_id < inputs.window_pbs.size());
    if (!IsHole(inputs.window_pbs[window_id])) windows.push_back(inputs.window_pbs[window_id]);
  }
  return windows;
}

std::uint64_t BytesOf(const std::vector<v1::ArtefactRef>& refs) {
  std::uint64_t bytes = 0;
  for (const v1::ArtefactRef& ref : refs) bytes += ref.bytes();
  return bytes;
}

void FillExportParams(const JobInputs& inputs, v1::TaskSpec* spec) {
  for (std::size_t i = 0; i < inputs.tiles.size(); ++i) {
    if (IsHole(inputs.tiles[i])) spec->mutable_export_params()->add_missing_tiles(static_cast<std::uint32_t>(i));
  }
  for (const v1::Note& hole : inputs.holes) *spec->mutable_export_params()->add_holes() = hole;
  for (const v1::Note& note : inputs.notes) *spec->mutable_export_params()->add_notes() = note;
}

// The key of a spec whose window.pb inputs have this digest; those that it holds are not looked at.
std::string KeyOf(const v1::TaskSpec& spec, const std::string& windows_digest, const std::string& job_id) {
  v1::TaskSpec stripped = spec;
  stripped.clear_key();
  stripped.clear_inputs();
  for (const v1::ArtefactRef& input : spec.inputs()) {
    if (input.name() != kWindowName) *stripped.add_inputs() = input;
  }
  std::string bytes = SerializeDeterministic(stripped) + "\nwindows " + windows_digest + "\nengine " + kEngineRevision;
  if (spec.kind() == v1::INGEST) bytes += "\njob " + job_id;
  return Sha256Hex(bytes);
}

// Which of the sortie's recordings a window lies in.
int RecordingOf(const JobInputs& inputs, const WindowPlan& window) {
  const auto& begins = inputs.ingest.recording_begins();
  int recording = 0;
  for (int k = 0; k < begins.size() && k <= inputs.sortie.more_size(); ++k) {
    if (begins[k] <= window.frame_begin) recording = k;
  }
  return recording;
}

void FillEnhance(const JobInputs& inputs, std::uint32_t index, v1::TaskSpec* spec) {
  TREM_CHECK(index < inputs.windows.size());
  const WindowPlan& window = inputs.windows[index];
  const auto part = static_cast<std::size_t>(RecordingOf(inputs, window));
  *spec->add_inputs() = part < inputs.recordings.size() ? inputs.recordings[part] : inputs.manifest;
  // What the windows of a recording are made of. Whatever else the sortie says must not change their keys: a mosaic at another distance,
  // more control or one more recording leaves them as they are.
  spec->mutable_sortie()->clear_name();
  spec->mutable_sortie()->clear_telemetry();
  spec->mutable_sortie()->clear_mosaic();
  spec->mutable_sortie()->clear_control();
  if (part > 0) *spec->mutable_sortie()->mutable_source() = inputs.sortie.more(static_cast<int>(part) - 1).source();
  spec->mutable_sortie()->clear_more();
  spec->mutable_enhance()->set_window_id(window.window_id);
  *spec->mutable_enhance()->mutable_roi_in_sensor() = ToProto(window.roi_in_sensor);
  spec->mutable_enhance()->set_frame_begin(window.frame_begin);
  spec->mutable_enhance()->set_frame_end(window.frame_end);
  spec->set_memory_bytes(EnhanceMemoryBytes(inputs.sortie, inputs.ingest.width_px(), inputs.ingest.height_px(), window));
}

// Whether tasks of this kind read every window.pb.
bool ReadsWindows(v1::TaskKind kind) { return kind == v1::ALIGN || kind == v1::EXPORT; }

// The spec without its key, and without the windows unless they are asked for.
v1::TaskSpec MakeSpec(const JobInputs& inputs, v1::TaskKind kind, std::uint32_t index, bool with_windows) {
  v1::TaskSpec spec;
  spec.set_kind(kind);
  *spec.mutable_sortie() = inputs.sortie;
  spec.set_seed(TaskSeed(inputs.sortie.seed(), kind, index));
  if (ReadsWindows(kind)) TREM_CHECK(inputs.window_pbs.size() == inputs.windows.size());
  if (kind == v1::COMPOSITE || kind == v1::EXPORT) *spec.add_inputs() = inputs.alignment;
  if (kind == v1::ALIGN || kind == v1::EXPORT) *spec.add_inputs() = inputs.manifest;
  if (ReadsWindows(kind) && with_windows) AddAll(inputs.window_pbs, &spec);
  switch (kind) {
    case v1::INGEST:
      spec.set_memory_bytes(IngestMemoryBytes());
      break;
    case v1::ENHANCE:
      FillEnhance(inputs, index, &spec);
      break;
    case v1::ALIGN:
      spec.set_memory_bytes(AlignMemoryBytes(inputs.ingest, inputs.window_pb_bytes));
      break;
    case v1::COMPOSITE:
      TREM_CHECK(index < inputs.align.tile_count());
      if (with_windows) AddAll(WindowsOfTile(inputs, index), &spec);
      spec.mutable_composite()->set_tile_index(index);
      spec.set_memory_bytes(CompositeMemoryBytes(inputs.sortie, BytesOf(WindowsOfTile(inputs, index))));
      break;
    case v1::EXPORT:
      TREM_CHECK(inputs.tiles.size() == inputs.align.tile_count());
      AddAll(inputs.tiles, &spec);
      FillExportParams(inputs, &spec);
      spec.set_memory_bytes(ExportMemoryBytes(inputs.ingest, inputs.window_pb_bytes));
      break;
    default:
      TREM_CHECK_MSG(false, "task kind " + std::to_string(kind));
  }
  return spec;
}

std::string KeyOfPlanned(const JobInputs& inputs, const v1::TaskSpec& spec) {
  if (spec.kind() == v1::COMPOSITE) {
    return KeyOf(spec, WindowsDigest(WindowsOfTile(inputs, spec.composite().tile_index())), inputs.job_id);
  }
  if (!ReadsWindows(spec.kind())) return KeyOf(spec, WindowsDigest({}), inputs.job_id);
  return KeyOf(spec, inputs.window_pbs_digest.empty() ? WindowsDigest(inputs.window_pbs) : inputs.window_pbs_digest, inputs.job_id);
}

}  // namespace

v1::TaskSpec PlanTask(const JobInputs& inputs, v1::TaskKind kind, std::uint32_t index) {
  v1::TaskSpec spec = MakeSpec(inputs, kind, index, true);
  spec.set_key(KeyOfPlanned(inputs, spec));
  return spec;
}

PlannedKey PlanTaskKey(const JobInputs& inputs, v1::TaskKind kind, std::uint32_t index) {
  const v1::TaskSpec spec = MakeSpec(inputs, kind, index, false);
  return {KeyOfPlanned(inputs, spec), spec.memory_bytes()};
}

std::string WindowsDigest(std::span<const v1::ArtefactRef> inputs) {
  std::string bytes;
  for (const v1::ArtefactRef& input : inputs) {
    if (input.name() == kWindowName && !IsHole(input)) bytes += SerializeDeterministic(input) + "\n";
  }
  return Sha256Hex(bytes);
}

std::string TaskKey(const v1::TaskSpec& spec, const std::string& job_id) {
  const std::vector<v1::ArtefactRef> inputs(spec.inputs().begin(), spec.inputs().end());
  return KeyOf(spec, WindowsDigest(inputs), job_id);
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
  if (kind == v1::INGEST && result.ingest().recording_begins_size() > 0 &&
      result.ingest().recording_begins_size() + 1 != result.outputs_size()) {
    return Failed("the result of an INGEST task has " + std::to_string(result.outputs_size()) + " outputs for " +
                  std::to_string(result.ingest().recording_begins_size()) + " recordings; expected one more than these");
  }
  if (kind == v1::INGEST && !result.has_ingest()) return Failed("the result of an INGEST task has no summary");
  if (kind == v1::ALIGN && (!result.has_align() || result.align().tile_count() == 0)) {
    return Failed("the result of an ALIGN task has no mosaic tile");
  }
  if (kind == v1::ALIGN && result.align().tile_count() > kTilesMax) {
    return Failed("the result of an ALIGN task has " + std::to_string(result.align().tile_count()) + " tiles; at most " +
                  std::to_string(kTilesMax) + " are possible: raise mosaic.tile_px or mosaic.gsd");
  }
  if (kind == v1::ALIGN && static_cast<std::uint32_t>(result.align().tiles_size()) != result.align().tile_count()) {
    return Failed("the result of an ALIGN task names the windows of " + std::to_string(result.align().tiles_size()) + " tiles; expected " +
                  std::to_string(result.align().tile_count()));
  }
  return {};
}

}  // namespace trem
