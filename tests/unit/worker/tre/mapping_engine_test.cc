// Goal: the engine makes a sharper scene than any frame, tracks views and gains without drift, and says so when it cannot. Method: moving
// sequences rendered from a known truth by a denser model than the engine's own; thresholds are about twice what is measured.
#include "worker/tre/mapping_engine.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>

#include "tests/support/rendered_sequence.h"
#include "tests/unit/worker/tre/mapped.h"

namespace trem {
namespace {

using testing::RenderedSequence;
using testing::SequenceOptions;
using Outcome = FrameReport::Outcome;

// 60 frames of 101 px: rendered and mapped once for the tests that only look.
const RenderedSequence& MovingSequence() {
  static const RenderedSequence sequence = [] {
    SequenceOptions options;
    options.roi_px = 101;
    return testing::RenderSequence(options);
  }();
  return sequence;
}
const Made& MovingMade() {
  static const Made made = Map(MovingSequence());
  return made;
}

// Cells that nobody has seen are 0 in both; only the bytes of what was made are compared.
bool SameBytes(const Image<float>& a, const Image<float>& b) {
  return a.width() == b.width() && a.height() == b.height() &&
         std::memcmp(a.pixels().data(), b.pixels().data(), a.pixels().size_bytes()) == 0;
}

TEST(MappingEngine, TheSceneIsAtLeastThreeDecibelsBetterThanABicubicFrame) {
  const Image<float> filtered = testing::Filtered121(MovingSequence().truth);
  ASSERT_FALSE(MovingMade().snapshots.empty());
  int scored = 0;
  for (const Snapshot& snapshot : MovingMade().snapshots) {
    const testing::SnapshotScore score = testing::ScoreSnapshot(MovingSequence(), filtered, snapshot.scene, 0, 12.0, 1e9);
    ASSERT_TRUE(score.bicubic_db.has_value());
    if (!score.scene_db) continue;
    EXPECT_GT(*score.scene_db, *score.bicubic_db + 3.0) << "scene " << snapshot.scene.scene_id;
    ++scored;
  }
  EXPECT_GT(scored, 0);
}

TEST(MappingEngine, SixtyFramesDoNotDrift) {
  const EngineResult& result = MovingMade().result;
  ASSERT_EQ(result.segments.size(), 1U);
  ASSERT_EQ(result.segments[0].chain.size(), 60U);
  EXPECT_EQ(Count(result, Outcome::kRegistered), 59);
  for (const ChainEntry& entry : result.segments[0].chain) {
    EXPECT_LT(testing::CornerError(MovingSequence(), entry, 0), 0.08) << "sensor px at frame " << entry.frame_index;
  }
}

TEST(MappingEngine, GainAndNoiseAreTracked) {
  const EngineResult& result = MovingMade().result;
  for (const ChainEntry& entry : result.segments[0].chain) {
    EXPECT_NEAR(entry.registration.view.gain, MovingSequence().gains[static_cast<std::size_t>(entry.frame_index)], 0.01)
        << "frame " << entry.frame_index;
  }
  EXPECT_NEAR(result.noise_sigma, 2.0, 0.3);
}

// ROI pixels two or more from its border, at every frame: their cells are seen in a snapshot.
TEST(MappingEngine, EveryExposedCellIsInASnapshot) {
  SequenceOptions options;
  options.speed_px = 3.0;
  options.frame_count = 40;
  const RenderedSequence sequence = testing::RenderSequence(options);
  const Made made = Map(sequence);
  ASSERT_GT(made.snapshots.size(), 1U) << "the ROI has to leave its first place for this test to mean anything";
  ASSERT_EQ(made.result.segments.size(), 1U);
  int missing = 0;
  for (const ChainEntry& entry : made.result.segments[0].chain) {
    for (int v = 2; v < options.roi_px - 2; ++v) {
      for (int u = 2; u < options.roi_px - 2; ++u) {
        const Eigen::Vector2d cell = entry.registration.view.scene_from_sensor * Eigen::Vector2d(u, v);
        const int x = static_cast<int>(std::lround(cell.x()));
        const int y = static_cast<int>(std::lround(cell.y()));
        missing += std::none_of(made.snapshots.begin(), made.snapshots.end(), [&](const Snapshot& s) {
          const Roi& extent = s.scene.extent;
          return extent.Contains(x, y) && s.scene.information.at(x - extent.x0, y - extent.y0) > 0.0F;
        });
      }
    }
  }
  EXPECT_EQ(missing, 0);
  // The frames of the snapshots tile the sequence.
  EXPECT_EQ(made.snapshots.front().scene.frame_begin, 0);
  EXPECT_EQ(made.snapshots.back().scene.frame_end, 40);
  for (std::size_t k = 1; k < made.snapshots.size(); ++k) {
    EXPECT_EQ(made.snapshots[k].scene.frame_begin, made.snapshots[k - 1].scene.frame_end);
  }
}

TEST(MappingEngine, AFrameOfSomethingElseIsLostAndDoesNoHarm) {
  RenderedSequence sequence = MovingSequence();
  const Image<float> frame = sequence.frames[30].pixels;
  for (int y = 0; y < frame.height(); ++y) {
    for (int x = 0; x < frame.width(); ++x) sequence.frames[30].pixels.at(x, y) = frame.at(y, x);
  }
  const Made made = Map(sequence);
  ASSERT_EQ(made.result.segments.size(), 1U);
  EXPECT_EQ(made.result.frames[30].outcome, Outcome::kLost);
  EXPECT_THAT(made.result.frames[30].reason, ::testing::HasSubstr("does not match"));
  EXPECT_EQ(Count(made.result, Outcome::kLost), 1);
  EXPECT_LT(testing::CornerError(sequence, made.result.segments[0].chain.back(), 0), 0.08);
}

TEST(MappingEngine, ASkippedFrameIsReportedAndBridged) {
  RenderedSequence sequence = MovingSequence();
  for (const std::size_t k : {std::size_t{0}, std::size_t{20}, std::size_t{21}}) {
    sequence.frames[k].skip_reason = "could not be read";
    sequence.frames[k].pixels = {};
    // Motion is measured from the usable frame before: over all the frames between.
    if (k > 0) sequence.frames[k].previous_from_current.reset();
  }
  sequence.frames[22].previous_from_current = sequence.truth_from_sensor[19].Inverse() * sequence.truth_from_sensor[22];
  const Made made = Map(sequence);
  ASSERT_EQ(made.result.segments.size(), 1U);
  EXPECT_EQ(Count(made.result, Outcome::kSkipped), 3);
  EXPECT_EQ(Count(made.result, Outcome::kRegistered), 56);
  EXPECT_EQ(made.result.frames[1].outcome, Outcome::kStartedScene);
  EXPECT_EQ(made.result.frames[20].reason, "could not be read");
}

TEST(MappingEngine, ACutStartsANewSegmentAndLosesNoFrame) {
  constexpr std::size_t kCut = 25;
  SequenceOptions options;
  options.frame_count = 45;
  RenderedSequence sequence = testing::RenderSequence(options);
  options.seed = 2;
  const RenderedSequence other = testing::RenderSequence(options);
  std::copy(other.frames.begin() + kCut, other.frames.end(), sequence.frames.begin() + kCut);
  sequence.frames[kCut].previous_from_current.reset();
  const Made made = Map(sequence);
  ASSERT_EQ(made.result.segments.size(), 2U);
  EXPECT_EQ(made.result.segments[0].chain.size(), kCut);
  EXPECT_EQ(made.result.segments[1].chain.front().frame_index, static_cast<int>(kCut));
  EXPECT_EQ(made.result.segments[1].chain.size(), 45 - kCut);
  EXPECT_EQ(made.result.frames[kCut].outcome, Outcome::kStartedScene);
  EXPECT_EQ(Count(made.result, Outcome::kLost), 0);
}

// A survey of photographs: what a frame's ROI shows, the next one's does not. None may wait for the scene to come back, and none be lost.
TEST(MappingEngine, ACameraThatHopsOnByMostOfItsRoiBeginsASceneWithEachFrame) {
  SequenceOptions options;
  options.frame_count = 6;
  options.speed_px = 55.0;
  RenderedSequence sequence = testing::RenderSequence(options);
  const Made hopping = Map(sequence);
  EXPECT_EQ(hopping.result.segments.size(), 6U);
  EXPECT_EQ(Count(hopping.result, Outcome::kStartedScene), 6);
  EXPECT_EQ(hopping.snapshots.size(), 6U);

  // Where nothing measured how far it went, four frames wait for the scene to come back before a new one begins.
  for (FrameInput& frame : sequence.frames) frame.previous_from_current.reset();
  EXPECT_EQ(Count(Map(sequence).result, Outcome::kLost), 4);

  options.speed_px = 8.0;
  const Made overlapping = Map(testing::RenderSequence(options));
  EXPECT_EQ(overlapping.result.segments.size(), 1U) << "six sevenths of a ROI overlap the one before it";
  EXPECT_EQ(Count(overlapping.result, Outcome::kRegistered), 5);
}

TEST(MappingEngine, TurningByFortyFiveDegreesMakesSegmentsThatShareFrames) {
  SequenceOptions options;
  options.turn_rad = 0.785 / options.frame_count;
  const RenderedSequence sequence = testing::RenderSequence(options);
  const Made made = Map(sequence);
  ASSERT_GE(made.result.segments.size(), 2U);
  EXPECT_EQ(Count(made.result, Outcome::kLost), 0);
  for (std::size_t k = 1; k < made.result.segments.size(); ++k) {
    const std::vector<ChainEntry>& before = made.result.segments[k - 1].chain;
    const std::vector<ChainEntry>& after = made.result.segments[k].chain;
    const int first = after.front().frame_index;
    const auto shared = std::count_if(before.begin(), before.end(), [&](const ChainEntry& e) { return e.frame_index >= first; });
    EXPECT_GE(shared, 4) << "segment " << k;
    // The shared frames relate the two planes: one affine map, whichever frame says it.
    for (const ChainEntry& entry : after) EXPECT_LT(testing::CornerError(sequence, entry, first), 0.15);
  }
  EXPECT_EQ(made.result.segments.back().chain.back().frame_index, options.frame_count - 1);
}

TEST(MappingEngine, TwoRunsGiveTheSameBytesForAnyNumberOfThreads) {
  RenderedSequence sequence = MovingSequence();
  sequence.frames.resize(20);
  for (const RegistrationMethod method : {RegistrationMethod::kAuto, RegistrationMethod::kHintsThenGaussNewton}) {
    EngineOptions options;
    options.registration = method;
    const Made a = Map(sequence, options);
    options.threads = 3;
    const Made b = Map(sequence, options);
    ASSERT_EQ(a.snapshots.size(), b.snapshots.size());
    for (std::size_t k = 0; k < a.snapshots.size(); ++k) {
      EXPECT_TRUE(SameBytes(a.snapshots[k].scene.intensity, b.snapshots[k].scene.intensity));
      EXPECT_TRUE(SameBytes(a.snapshots[k].scene.information, b.snapshots[k].scene.information));
    }
    ASSERT_EQ(a.result.segments[0].chain.size(), b.result.segments[0].chain.size());
    for (std::size_t k = 0; k < a.result.segments[0].chain.size(); ++k) {
      const Registration& left = a.result.segments[0].chain[k].registration;
      const Registration& right = b.result.segments[0].chain[k].registration;
      EXPECT_EQ(left.view.scene_from_sensor.linear, right.view.scene_from_sensor.linear);
      EXPECT_EQ(left.view.scene_from_sensor.offset, right.view.scene_from_sensor.offset);
      EXPECT_EQ(left.corner_covariance, right.corner_covariance);
    }
  }
}

TEST(MappingEngine, CancelsAndRefusesWhatCannotWork) {
  const SnapshotSink sink = [](int, const SceneSnapshot&) { return Status{}; };
  const RenderedSequence& sequence = MovingSequence();
  EXPECT_EQ(RunMapping(sequence.roi, sequence.frames, {}, sink, [](double) { return false; }).status().code(), StatusCode::kCancelled);
  EXPECT_EQ(RunMapping({0, 0, 15, 61}, {}, {}, sink, {}).status().code(), StatusCode::kInvalidInput);
  EngineOptions options;
  options.ratio = 5;
  EXPECT_EQ(RunMapping(sequence.roi, sequence.frames, options, sink, {}).status().code(), StatusCode::kInvalidInput);
}

}  // namespace
}  // namespace trem
