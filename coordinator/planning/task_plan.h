#pragma once

#include <cstdint>
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
  std::vector<WindowPlan> windows;          // After INGEST: PlanWindows.
  std::vector<v1::ArtefactRef> window_pbs;  // After ENHANCE: the first output of each, in window order.
  std::uint64_t window_pb_bytes = 0;        // Sum of their sizes.
  v1::AlignSummary align;                   // After ALIGN.
  v1::ArtefactRef alignment;                // After ALIGN.
  std::vector<v1::ArtefactRef> tiles;       // After COMPOSITE: the first output of each, in tile order.
};

// The task of `kind` number `index` (window id for ENHANCE, tile index for COMPOSITE, 0 for the others) with its inputs:
//   INGEST     none
//   ENHANCE    manifest.pb
//   ALIGN      manifest.pb, every window.pb in window order
//   COMPOSITE  alignment.pb, every window.pb in window order
//   EXPORT     alignment.pb, manifest.pb, every window.pb, every tile.tif in tile order
// Its result's outputs must begin with MainArtefactName(kind), except for EXPORT, whose outputs are the user's files.
// Precondition: what the kind needs of `inputs` is filled in.
v1::TaskSpec PlanTask(const JobInputs& inputs, v1::TaskKind kind, std::uint32_t index);

// SHA-256 of the spec's deterministic bytes without its key, and of the engine revision: same key, same bytes. An INGEST's input is a
// path, not a digest, so the job's id goes into its key too: a source that has changed since an earlier job is read again, while the
// tasks after it are shared between jobs whose manifests are equal.
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
