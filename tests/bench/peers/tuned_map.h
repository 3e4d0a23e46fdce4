#pragma once

#include "tests/bench/peers/wiener.h"

namespace trem::bench {

// The converged maximum a posteriori scene (testing::BatchMap) of the first `frame_count` frames with their true views, gains and
// offsets, under the engine's own prior with the weight tuned to the truth of this very scene. One frame: what the prior alone can do.
// All frames: what the engine's recursion is held against. `answer` is the better scoring of the scene and the scene filtered by
// [1 2 1] / 4 like the truth; `setting` is the weight.
TunedAnswer TunedMap(const BenchScene& scene, int frame_count);

}  // namespace trem::bench
