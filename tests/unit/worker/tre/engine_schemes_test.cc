// Goal: the whole engine works with every update scheme and every structure model: sharper than a bicubic frame, registered without
// drift, over moving ground, and the same bytes twice. Method: rendered sequences with known truth; thresholds below what is measured.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>

#include "tests/support/rendered_sequence.h"

namespace trem {
namespace {

using testing::RenderedSequence;
using testing::SequenceOptions;

struct Made {
  EngineResult result;
  std::vector<SceneSnapshot> snapshots;
};

Made Map(const RenderedSequence& sequence, const EngineOptions& options) {
  Made made;
  const SnapshotSink sink = [&](int, const SceneSnapshot& snapshot) {
    made.snapshots.push_back(snapshot);
    return Status{};
  };
  Result<EngineResult> result = RunMapping(sequence.roi, sequence.frames, options, sink, {});
  TREM_CHECK_MSG(result.ok(), result.status().message());
  made.result = std::move(*result);
  return made;
}

// 20 frames of 61 px that move by 2 px each: the buffer has to move on.
const RenderedSequence& Sequence() {
  static const RenderedSequence sequence = [] {
    SequenceOptions options;
    options.frame_count = 20;
    options.speed_px = 2.0;
    return testing::RenderSequence(options);
  }();
  return sequence;
}

// Of the first snapshot on ground that several frames have seen.
double GainOverBicubic(const Made& made) {
  const testing::SnapshotScore score =
      testing::ScoreSnapshot(Sequence(), testing::Filtered121(Sequence().truth), made.snapshots.front(), 0, 4.0, 1e9);
  return score.scene_db.value_or(0.0) - score.bicubic_db.value_or(1e9);
}

double LargestCornerError(const Made& made) {
  double largest = 0.0;
  for (const ChainEntry& entry : made.result.segments[0].chain) largest = std::max(largest, testing::CornerError(Sequence(), entry, 0));
  return largest;
}

void ExpectGoodScene(const EngineOptions& options, double gain_min_db, double corner_error_max = 0.12) {
  const Made made = Map(Sequence(), options);
  ASSERT_EQ(made.result.segments.size(), 1U);
  EXPECT_EQ(made.result.segments[0].chain.size(), 20U);
  ASSERT_GT(made.snapshots.size(), 1U) << "the buffer has to move for this test to mean anything";
  EXPECT_GT(GainOverBicubic(made), gain_min_db);
  EXPECT_LT(LargestCornerError(made), corner_error_max);
}

TEST(EngineSchemes, EveryStructureModelMakesASharperScene) {
  for (const StructurePriorKind kind :
       {StructurePriorKind::kHuberTv, StructurePriorKind::kMembrane, StructurePriorKind::kLaplacian, StructurePriorKind::kBilateralTv}) {
    SCOPED_TRACE(static_cast<int>(kind));
    EngineOptions options;
    options.structure = kind;
    ExpectGoodScene(options, 2.0);
  }
}

TEST(EngineSchemes, LandweberMakesASharperScene) {
  for (const int window : {1, 8}) {
    SCOPED_TRACE(window);
    EngineOptions options;
    options.update = UpdateMethod::kLandweber;
    options.landweber_window = window;
    // A recursion that knows one frame at a time registers to its own last answer, and drifts.
    ExpectGoodScene(options, window == 1 ? 0.5 : 1.5, window == 1 ? 0.5 : 0.12);
  }
}

TEST(EngineSchemes, PointwiseMakesASharperScene) {
  EngineOptions options;
  options.update = UpdateMethod::kPointwise;
  ExpectGoodScene(options, 2.0);
}

// A revisited frame's entry differs from what was measured when it came, and is not worse for it.
TEST(EngineSchemes, RevisitsImproveTheChain) {
  EngineOptions options;
  options.update = UpdateMethod::kLandweber;
  const Made once = Map(Sequence(), options);
  options.landweber_revisit = true;
  const Made again = Map(Sequence(), options);
  const auto& before = once.result.segments[0].chain;
  const auto& after = again.result.segments[0].chain;
  ASSERT_EQ(before.size(), after.size());
  int changed = 0;
  for (std::size_t k = 0; k < after.size(); ++k) {
    EXPECT_EQ(before[k].frame_index, after[k].frame_index);
    changed += before[k].registration.view.scene_from_sensor.offset == after[k].registration.view.scene_from_sensor.offset ? 0 : 1;
  }
  EXPECT_GT(changed, 4);
  EXPECT_EQ(before[0].registration.view.scene_from_sensor.offset, after[0].registration.view.scene_from_sensor.offset) << "the gauge stays";
  EXPECT_LT(LargestCornerError(again), LargestCornerError(once) + 0.02);
}

TEST(EngineSchemes, TwoRunsGiveTheSameBytes) {
  for (const UpdateMethod method : {UpdateMethod::kLandweber, UpdateMethod::kPointwise}) {
    EngineOptions options;
    options.update = method;
    options.landweber_revisit = method == UpdateMethod::kLandweber;
    const Made a = Map(Sequence(), options);
    const Made b = Map(Sequence(), options);
    ASSERT_EQ(a.snapshots.size(), b.snapshots.size());
    for (std::size_t k = 0; k < a.snapshots.size(); ++k) {
      const Image<float>& left = a.snapshots[k].intensity;
      const Image<float>& right = b.snapshots[k].intensity;
      ASSERT_EQ(left.pixels().size(), right.pixels().size());
      EXPECT_EQ(std::memcmp(left.pixels().data(), right.pixels().data(), left.pixels().size_bytes()), 0);
    }
  }
}

}  // namespace
}  // namespace trem
