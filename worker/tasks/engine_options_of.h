#pragma once

#include "proto/trem/v1/task.pb.h"
#include "worker/tre/engine_options.h"

namespace trem {

// The engine's options for a task of a sortie: the spec's, in internal grey levels, and what ingest estimated where the spec is silent.
EngineOptions EngineOptionsOf(const v1::TaskSpec& spec, const v1::SortieManifest& manifest);

}  // namespace trem
