#include "tests/bench/peers/engine_peer.h"

#include <algorithm>
#include <chrono>

namespace trem::bench {
namespace {

// The snapshot's cells where they lie on the answers' grid, and the bicubic frame where it has none.
Image<float> OnAnswerGrid(const BenchScene& scene, const SceneSnapshot& snapshot) {
  Image<float> answer = Bicubic(scene);
  for (int y = 0; y < answer.height(); ++y) {
    for (int x = 0; x < answer.width(); ++x) {
      const int sx = x - snapshot.extent.x0;
      const int sy = y - snapshot.extent.y0;
      if (sx < 0 || sy < 0 || sx >= snapshot.intensity.width() || sy >= snapshot.intensity.height()) continue;
      if (snapshot.information.at(sx, sy) > 0.0F) answer.at(x, y) = snapshot.intensity.at(sx, sy);
    }
  }
  return answer;
}

}  // namespace

Result<EngineAnswer> RunEngine(const BenchScene& scene, EngineOptions options) {
  options.psf = scene.psf();
  options.ratio = BenchScene::kRatio;
  EngineAnswer engine;
  SceneSnapshot last;
  const SnapshotSink sink = [&](int segment, const SceneSnapshot& snapshot) {
    if (segment == 0) last = snapshot;
    return Status{};
  };
  const auto start = std::chrono::steady_clock::now();
  TREM_ASSIGN_OR_RETURN(const EngineResult result, RunMapping(scene.sequence.roi, scene.sequence.frames, options, sink, {}));
  engine.ms_per_frame = 1e3 * std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count() / scene.options.frame_count;
  engine.answer = OnAnswerGrid(scene, last);
  engine.noise_sigma = result.noise_sigma;
  for (const ChainEntry& entry : result.segments[0].chain) {
    engine.corner_errors.push_back(testing::CornerError(scene.sequence, entry, 0));
    engine.views.push_back(entry.registration.view);
  }
  engine.lost = static_cast<int>(std::count_if(result.frames.begin(), result.frames.end(),
                                               [](const FrameReport& frame) { return frame.outcome == FrameReport::Outcome::kLost; }));
  return engine;
}

}  // namespace trem::bench
