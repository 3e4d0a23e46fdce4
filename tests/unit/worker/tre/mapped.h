#pragma once

#include <algorithm>
#include <utility>
#include <vector>

#include "mosaic/base/check.h"
#include "tests/support/rendered_sequence.h"
#include "worker/tre/mapping_engine.h"

namespace trem {

struct Snapshot {
  int segment = 0;
  SceneSnapshot scene;
};

struct Made {
  EngineResult result;
  std::vector<Snapshot> snapshots;
};

// The engine over a whole sequence, with all that it emits.
inline Made Map(const testing::RenderedSequence& sequence, const EngineOptions& options = {}) {
  Made made;
  const SnapshotSink sink = [&](int segment, const SceneSnapshot& scene) {
    made.snapshots.push_back({segment, scene});
    return Status{};
  };
  Result<EngineResult> result = RunMapping(sequence.roi, sequence.frames, options, sink, {});
  TREM_CHECK_MSG(result.ok(), result.status().message());
  made.result = std::move(*result);
  return made;
}

inline int Count(const EngineResult& result, FrameReport::Outcome outcome) {
  return static_cast<int>(
      std::count_if(result.frames.begin(), result.frames.end(), [&](const FrameReport& f) { return f.outcome == outcome; }));
}

}  // namespace trem
