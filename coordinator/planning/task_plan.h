#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "coordinator/planning/window_plan.h"
#include "mosaic/base/status.h"
#include "proto/trem/v1/job.pb.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// Everything that earlier stages of a job have found and later specs are made of. Pure functions of this make TaskSpecs, so a spec is
// built when it is handed out and need not be kept.
struct JobInputs {
  std::string job_id;
  v1::Sortie sortie;                        // Complete.
  v1::IngestSummary ingest;                 // After INGEST.
  v1::ArtefactRef manifest;                 // After INGEST.
  // After INGEST: what ENHANCE tasks read of it, one a recording (IngestSummary.recording_begins); none: the manifest itself.
  std::vector<v1::ArtefactRef> recordings;
  std::vector<WindowPlan> windows;          // After INGEST: PlanWindows.
  std::vector<v1::ArtefactRef> window_pbs;  // After ENHANCE: the first output of each, in window order; without a digest: a hole.
  std::string window_pbs_digest;            // After ENHANCE: WindowsDigest, computed once for the many tasks whose keys hold it.
  std::uint64_t window_pb_bytes = 0;        // Sum of their sizes.
  v1::AlignSummary align;                   // After ALIGN.
  v1::ArtefactRef alignment;                // After ALIGN.
  std::vector<v1::ArtefactRef> tiles;       // After COMPOSITE: the first output of each, in tile order; without a digest: a hole.
  std::vector<v1::Note> holes;              // Tasks that were given up, for the report.
  std::vector<v1::Note> notes;              // After COMPOSITE: of all tasks, sorted and unique, for the report.
};

// The task of `kind` number `index` (window id for ENHANCE, tile index for COMPOSITE, 0 for the others) with its inputs:
//   INGEST     none
//   ENHANCE    manifest.pb, of the window's recording; its spec names nothing of the sortie that does not matter to it
//   ALIGN      manifest.pb, every window.pb in window order
//   COMPOSITE  alignment.pb, the window.pb of the windows that reach the tile, in window order
//   EXPORT     alignment.pb, manifest.pb, every window.pb, every tile.tif in tile order
// Windows and tiles that are holes are left out; EXPORT's params name the missing tiles.
// Its result's outputs must begin with MainArtefactName(kind), except for EXPORT, whose outputs are the user's files.
// Precondition: what the kind needs of `inputs` is filled in.
v1::TaskSpec PlanTask(const JobInputs& inputs, v1::TaskKind kind, std::uint32_t index);

// The key and memory bound that PlanTask gives, without the list of windows, which is long and the same in every task of a stage.
struct PlannedKey {
  std::string key;
  std::uint64_t memory_bytes = 0;
};
PlannedKey PlanTaskKey(const JobInputs& inputs, v1::TaskKind kind, std::uint32_t index);

// SHA-256 of the deterministic bytes of every window.pb in `inputs`, in order; those without a digest are left out.
std::string WindowsDigest(std::span<const v1::ArtefactRef> inputs);

// SHA-256 of the spec's deterministic bytes without its key and windows, of WindowsDigest, and of the engine revision: same key, same
// bytes. An INGEST's input is a path, not a digest, so the job's id goes into its key too: a source that has changed since an earlier job
// is read again, while the tasks after it are shared between jobs whose manifests are equal.
std::string TaskKey(const v1::TaskSpec& spec, const std::string& job_id);

// SplitMix64 (Steele, Lea & Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014) finaliser applied to
// sortie_seed, then mixed with kind, then with index: distinct places get unrelated seeds, the same place always the same.
std::uint64_t TaskSeed(std::uint64_t sortie_seed, v1::TaskKind kind, std::uint32_t index);

// "manifest.pb", "window.pb", "alignment.pb", "tile.tif"; empty for EXPORT.
std::string MainArtefactName(v1::TaskKind kind);

// What a user reads: "INGEST", "ENHANCE window 12", "COMPOSITE tile 3".
std::string TaskTitle(v1::TaskKind kind, std::uint32_t index);

// Whether a worker's result holds what later stages need. kFailed, naming what is missing, when not.
Status CheckTaskResult(v1::TaskKind kind, const v1::TaskResult& result);

}  // namespace trem
