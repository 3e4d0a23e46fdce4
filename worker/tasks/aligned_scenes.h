#pragma once

#include <cstdint>
#include <map>
#include <span>
#include <utility>
#include <vector>

#include "mosaic/base/artefact_store.h"
#include "mosaic/base/status.h"
#include "mosaic/composite/tile_compositor.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// (window_id, scene_id).
using SceneKey = std::pair<std::uint32_t, std::uint32_t>;

// Rasters of the scenes that a job's windows emitted.
using EmittedScenes = std::map<SceneKey, v1::EmittedScene>;

// Adds the scenes of one window; kCorrupt when one is there twice.
Status AddEmittedScenes(const v1::WindowResult& window, EmittedScenes* emitted);

// The alignment's scenes as the compositor wants them, in the alignment's order; `rasters` gets their artefacts in the same order.
// kCorrupt when a scene of the alignment was emitted by no window or its numbers are not valid.
Result<std::vector<CompositeScene>> PlacedScenes(const v1::Alignment& alignment, const EmittedScenes& emitted,
                                                 std::vector<ArtefactRef>* rasters);

}  // namespace trem
