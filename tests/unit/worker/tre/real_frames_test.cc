// Goal: what recordings hold besides good frames (jumps of brightness, cuts, dissolves, repeats, dropouts, noise, clipped highlights) is
// recognised, told, and neither smears a scene nor costs a good frame. Method: sequences rendered from known truth, with the fault put in.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <iterator>
#include <limits>
#include <optional>

#include "mosaic/base/rng.h"
#include "tests/support/rendered_sequence.h"
#include "tests/support/sensor_faults.h"
#include "tests/unit/worker/tre/mapped.h"
#include "worker/sensor/bicubic.h"
#include "worker/tre/frame_check.h"
#include "worker/tre/mapping_engine.h"

namespace trem {
namespace {

using testing::RenderedSequence;
using testing::SequenceOptions;
using Outcome = FrameReport::Outcome;

SequenceOptions Small(int frames) {
  SequenceOptions options;
  options.frame_count = frames;
  return options;
}

const RenderedSequence& Clean() {
  static const RenderedSequence sequence = testing::RenderSequence(Small(40));
  return sequence;
}

// Of the last snapshot of the segment that began at `first`, on what at least 12 frames have seen.
double SceneDb(const RenderedSequence& sequence, const Made& made, int first) {
  const Image<float> filtered = testing::Filtered121(sequence.truth);
  std::optional<double> db;
  for (const Snapshot& snapshot : made.snapshots) {
    const int begins = made.result.segments[static_cast<std::size_t>(snapshot.segment)].chain.front().frame_index;
    if (begins != first) continue;
    const auto score = testing::ScoreSnapshot(sequence, filtered, snapshot.scene, first, 12.0, 1e9);
    if (score.scene_db) db = score.scene_db;
  }
  TREM_CHECK_MSG(db.has_value(), "no snapshot to score");
  return *db;
}

double WorstCornerError(const RenderedSequence& sequence, const SegmentResult& segment) {
  double worst = 0.0;
  for (const ChainEntry& entry : segment.chain) {
    worst = std::max(worst, testing::CornerError(sequence, entry, segment.chain.front().frame_index));
  }
  return worst;
}

bool HasNote(const EngineResult& result, const std::string& code, int frame) {
  return std::any_of(result.notes.begin(), result.notes.end(),
                     [&](const EngineNote& note) { return note.code == code && note.frame_index == frame; });
}

TEST(RealFrames, CleanFramesRaiseNoNote) {
  const Made made = Map(Clean());
  EXPECT_THAT(made.result.notes, ::testing::IsEmpty());
  EXPECT_EQ(Count(made.result, Outcome::kRegistered), 39);
}

TEST(RealFrames, AJumpOfGainAndOffsetIsAbsorbedAndTold) {
  constexpr std::size_t kJump = 20;
  // A ROI large enough that one frame's registration is not what is measured.
  SequenceOptions options = Small(40);
  options.roi_px = 101;
  options.speed_px = 1.9;
  const RenderedSequence clean = testing::RenderSequence(options);
  RenderedSequence sequence = clean;
  testing::JumpBrightness(0.7, 0.0, 0, &sequence);
  testing::JumpBrightness(2.0, 40.0, kJump, &sequence);
  const Made made = Map(sequence);
  ASSERT_EQ(made.result.segments.size(), 1U);
  EXPECT_EQ(Count(made.result, Outcome::kRegistered), 39);
  ASSERT_EQ(made.result.notes.size(), 1U);
  EXPECT_EQ(made.result.notes[0].code, "brightness_jump");
  EXPECT_EQ(made.result.notes[0].frame_index, static_cast<int>(kJump));
  EXPECT_THAT(made.result.notes[0].text, ::testing::HasSubstr("contrast times 2.0"));
  EXPECT_LT(WorstCornerError(sequence, made.result.segments[0]), 0.14);
  EXPECT_GT(SceneDb(sequence, made, 0), SceneDb(clean, Map(clean), 0) - 0.5);
}

// Frame `cut` is half the old and half the new scene; ingest saw nothing and reports a plausible motion.
TEST(RealFrames, ACutBehindADissolveLosesTheDissolveOnly) {
  constexpr std::size_t kCut = 20;
  RenderedSequence sequence = Clean();
  SequenceOptions options = Small(40);
  options.seed = 2;
  const RenderedSequence other = testing::RenderSequence(options);
  for (std::size_t k = kCut; k < sequence.frames.size(); ++k) sequence.frames[k] = other.frames[k];
  for (std::size_t i = 0; i < other.frames[kCut].pixels.pixels().size(); ++i) {
    sequence.frames[kCut].pixels.pixels()[i] = 0.5F * (Clean().frames[kCut].pixels.pixels()[i] + other.frames[kCut].pixels.pixels()[i]);
  }
  const Made made = Map(sequence);
  ASSERT_EQ(made.result.segments.size(), 2U);
  EXPECT_EQ(made.result.segments[0].chain.size(), kCut);
  EXPECT_EQ(made.result.frames[kCut].outcome, Outcome::kLost);
  EXPECT_EQ(made.result.segments[1].chain.front().frame_index, static_cast<int>(kCut) + 1);
  EXPECT_EQ(made.result.segments[1].chain.size(), sequence.frames.size() - kCut - 1);
  EXPECT_EQ(Count(made.result, Outcome::kLost), 1);
  EXPECT_TRUE(HasNote(made.result, "cut", static_cast<int>(kCut) + 1));
  EXPECT_LT(WorstCornerError(other, made.result.segments[1]), 0.1);
  EXPECT_GT(SceneDb(other, made, static_cast<int>(kCut) + 1), 24.0) << "the new scene holds nothing of the old one";
}

// Two frames before the window's end there is no time for a run of lost frames.
TEST(RealFrames, ACutShortBeforeTheEndLosesNoFrame) {
  RenderedSequence sequence = Clean();
  SequenceOptions options = Small(40);
  options.seed = 2;
  const RenderedSequence other = testing::RenderSequence(options);
  for (std::size_t k = 38; k < 40; ++k) sequence.frames[k] = other.frames[k];
  const Made made = Map(sequence);
  EXPECT_EQ(Count(made.result, Outcome::kLost), 0);
  ASSERT_EQ(made.result.segments.size(), 2U);
  EXPECT_EQ(made.result.segments[1].chain.size(), 2U);
}

TEST(RealFrames, ARepeatedFrameThatWasEncodedAgainCountsOnce) {
  RenderedSequence sequence = Clean();
  Rng rng({8});
  // Frames 10 and 11 show 9 again; 12 goes on from there.
  for (const std::size_t k : {std::size_t{10}, std::size_t{11}}) {
    sequence.frames[k].pixels = sequence.frames[k - 1].pixels;
    for (float& pixel : sequence.frames[k].pixels.pixels()) pixel += static_cast<float>(0.3 * rng.Normal());
    sequence.frames[k].previous_from_current = Affine{};
  }
  sequence.frames[12].previous_from_current = sequence.truth_from_sensor[9].Inverse() * sequence.truth_from_sensor[12];
  const Made made = Map(sequence);
  ASSERT_EQ(made.result.segments.size(), 1U);
  EXPECT_EQ(made.result.segments[0].chain.size(), 38U);
  for (const std::size_t k : {std::size_t{10}, std::size_t{11}}) {
    EXPECT_EQ(made.result.frames[k].outcome, Outcome::kSkipped);
    EXPECT_THAT(made.result.frames[k].reason, ::testing::HasSubstr("repeats"));
  }
  EXPECT_LT(WorstCornerError(sequence, made.result.segments[0]), 0.08);
}

TEST(RealFrames, AStillCameraWithNewNoiseIsNotARepeat) {
  const RenderedSequence& sequence = Clean();
  SequenceOptions options = Small(2);
  const Image<float> a = testing::RenderFrame(sequence.truth, options, sequence.truth_from_sensor[0], 1.0, 0.0, 1);
  const Image<float> b = testing::RenderFrame(sequence.truth, options, sequence.truth_from_sensor[0], 1.0, 0.0, 2);
  EXPECT_FALSE(Repeats(a, b, 2.0));
  EXPECT_FALSE(Repeats(a, b, 6.0)) << "with the noise thought to be three times what it is";
  EXPECT_TRUE(Repeats(a, a, 2.0));
}

TEST(RealFrames, AGapOfFourFramesWithoutMeasuredMotionIsBridged) {
  RenderedSequence sequence = Clean();
  sequence.frames.erase(sequence.frames.begin() + 20, sequence.frames.begin() + 24);
  sequence.frames[20].previous_from_current.reset();
  const Made made = Map(sequence);
  ASSERT_EQ(made.result.segments.size(), 1U);
  EXPECT_EQ(made.result.segments[0].chain.size(), 36U);
  EXPECT_LT(WorstCornerError(sequence, made.result.segments[0]), 0.12);
}

TEST(RealFrames, DropoutsAreSkippedWithAReasonWhereverTheyStand) {
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  for (const std::size_t at : {std::size_t{0}, std::size_t{15}}) {
    RenderedSequence sequence = Clean();
    Rng rng({3});
    for (float& pixel : sequence.frames[at].pixels.pixels()) pixel = kNan;
    for (float& pixel : sequence.frames[at + 1].pixels.pixels()) pixel = 97.0F;
    for (float& pixel : sequence.frames[at + 2].pixels.pixels()) pixel = static_cast<float>(110.0 + 40.0 * rng.Normal());
    for (int y = 0; y < 50; ++y) std::fill_n(sequence.frames[at + 3].pixels.row(y), 61, std::numeric_limits<float>::infinity());
    const Made made = Map(sequence);
    ASSERT_EQ(made.result.segments.size(), 1U);
    EXPECT_EQ(made.result.segments[0].chain.size(), 36U);
    const char* const expected[] = {"0 % usable pixels", "is constant", "is noise", "% usable pixels"};
    for (std::size_t k = 0; k < 4; ++k) {
      EXPECT_EQ(made.result.frames[at + k].outcome, Outcome::kSkipped);
      EXPECT_THAT(made.result.frames[at + k].reason, ::testing::HasSubstr(expected[k]));
    }
    EXPECT_LT(WorstCornerError(sequence, made.result.segments[0]), 0.1);
  }
}

TEST(RealFrames, AFrameWithALargeHoleIsUsedWhereItHasPixels) {
  RenderedSequence sequence = Clean();
  for (const std::size_t k : {std::size_t{0}, std::size_t{12}}) {
    for (int y = 0; y < 35; ++y) std::fill_n(sequence.frames[k].pixels.row(y), 61, std::numeric_limits<float>::quiet_NaN());
  }
  const Made made = Map(sequence);
  ASSERT_EQ(made.result.segments.size(), 1U);
  EXPECT_EQ(made.result.segments[0].chain.size(), 40U);
  // At first the upper corners hang on the strip below the hole, 35 px away; what the scene's upper part then gets wrong is its gauge.
  for (const ChainEntry& entry : made.result.segments[0].chain) {
    EXPECT_LT(testing::CornerError(sequence, entry, 0), entry.frame_index < 10 ? 0.4 : 0.25) << "frame " << entry.frame_index;
  }
  EXPECT_GT(SceneDb(sequence, made, 0), SceneDb(Clean(), Map(Clean()), 0) - 0.5);
}

// Nothing to hold on to: the views follow the measured motion with an honest uncertainty, and the picture stays flat.
TEST(RealFrames, ARoiWithoutTextureInventsNothing) {
  RenderedSequence sequence = Clean();
  Rng rng({6});
  for (FrameInput& frame : sequence.frames) {
    for (float& pixel : frame.pixels.pixels()) pixel = static_cast<float>(100.0 + 2.0 * rng.Normal());
  }
  const Made made = Map(sequence);
  for (const SegmentResult& segment : made.result.segments) {
    for (const ChainEntry& entry : segment.chain) {
      if (entry.frame_index == segment.chain.front().frame_index) continue;
      EXPECT_GT(std::sqrt(entry.registration.corner_covariance(0, 0)), 0.1) << "frame " << entry.frame_index;
    }
  }
  for (const Snapshot& snapshot : made.snapshots) {
    for (std::size_t i = 0; i < snapshot.scene.intensity.pixels().size(); ++i) {
      if (snapshot.scene.information.pixels()[i] < 5.0F) continue;
      ASSERT_NEAR(snapshot.scene.intensity.pixels()[i], 100.0F, 12.0F);
    }
  }
}

// Clipped highlights that are told by weight 0: the scene is as good beside them, and the views are not bent. What lies behind the clip
// stays between the clip and what a scene can hold: no rings.
TEST(RealFrames, ClippedHighlightsNeitherRingNorBend) {
  constexpr double kLevel = 170.0;
  RenderedSequence sequence = Clean();
  testing::Saturate(kLevel, true, &sequence);
  const Made made = Map(sequence);
  ASSERT_EQ(made.result.segments.size(), 1U);
  EXPECT_EQ(made.result.segments[0].chain.size(), 40U);
  EXPECT_LT(WorstCornerError(sequence, made.result.segments[0]), 0.12);
  const Image<float> filtered = testing::Filtered121(sequence.truth);
  const SceneSnapshot& snapshot = made.snapshots.back().scene;
  const Affine scene_from_truth = sequence.TruthFromScene(0).Inverse();
  double squares = 0.0;
  int dark = 0;
  for (int y = 1; y + 1 < filtered.height(); ++y) {
    for (int x = 1; x + 1 < filtered.width(); ++x) {
      const Eigen::Vector2d cell = scene_from_truth * Eigen::Vector2d(x, y) - Eigen::Vector2d(snapshot.extent.x0, snapshot.extent.y0);
      if (!CubicSupported(snapshot.intensity, cell.x(), cell.y())) continue;
      const int cx = static_cast<int>(cell.x() + 0.5);
      const int cy = static_cast<int>(cell.y() + 0.5);
      if (snapshot.information.at(cx, cy) < 12.0F) continue;
      const float value = SampleCubic(snapshot.intensity, cell.x(), cell.y());
      EXPECT_GT(value, 0.0F);
      EXPECT_LT(value, 300.0F);
      if (filtered.at(x, y) > 150.0F) continue;
      squares += std::pow(value - filtered.at(x, y), 2);
      ++dark;
    }
  }
  ASSERT_GT(dark, 1000);
  EXPECT_LT(std::sqrt(squares / dark), 6.0);
}

float NastyValue(Rng* rng) {
  constexpr float kValues[] = {0.0F,
                               -0.0F,
                               255.0F,
                               1e30F,
                               -1e30F,
                               1e-40F,
                               std::numeric_limits<float>::infinity(),
                               -std::numeric_limits<float>::infinity(),
                               1e6F,
                               -1e6F,
                               65535.0F,
                               std::numeric_limits<float>::quiet_NaN()};
  return kValues[static_cast<std::size_t>(rng->Uniform() * std::size(kValues)) % std::size(kValues)];
}

// Spoils a frame, its weights or its motion in one of many ways.
void SpoilAtRandom(Rng* rng, FrameInput* frame) {
  Image<float>& pixels = frame->pixels;
  const int kind = static_cast<int>(rng->Uniform() * 9.0);
  const double part = rng->Uniform();
  if (kind == 0) std::fill(pixels.pixels().begin(), pixels.pixels().end(), NastyValue(rng));
  for (float& pixel : pixels.pixels()) {
    if (kind == 1 && rng->Uniform() < part) pixel = NastyValue(rng);
    if (kind == 2) pixel = static_cast<float>(100.0 + 60.0 * rng->Normal());
    if (kind == 3) pixel = pixel * static_cast<float>(4.0 * part) - 50.0F;
  }
  if (kind == 4) {
    const int edge = static_cast<int>(part * pixels.height());
    for (int y = 0; y < edge; ++y) std::fill_n(pixels.row(y), pixels.width(), NastyValue(rng));
  }
  if (kind == 5) {
    frame->weights = Image<float>(pixels.width(), pixels.height(), 1.0F);
    for (float& weight : frame->weights.pixels()) weight = rng->Uniform() < part ? 0.0F : static_cast<float>(10.0 * rng->Uniform());
  }
  if (kind == 6) frame->previous_from_current.reset();
  if (kind == 7) frame->previous_from_current = Affine{Eigen::Matrix2d::Identity() * (0.5 + part), Eigen::Vector2d(500.0 * part, -300.0)};
}

// Whatever comes in, what comes out is finite, and every frame has an outcome.
TEST(RealFrames, RandomFaultsNeverMakeAnythingThatIsNotFinite) {
  SequenceOptions options = Small(16);
  options.roi_px = 41;
  options.speed_px = 2.0;
  const RenderedSequence clean = testing::RenderSequence(options);
  for (std::uint64_t seed = 0; seed < 12; ++seed) {
    Rng rng({seed, 31});
    RenderedSequence sequence = clean;
    for (FrameInput& frame : sequence.frames) {
      if (rng.Uniform() < 0.4) SpoilAtRandom(&rng, &frame);
    }
    EngineOptions engine;
    engine.detector_bias = seed % 2 == 0 ? Correction::kOn : Correction::kAuto;
    engine.registration = RegistrationMethod::kGaussNewton;
    const Made made = Map(sequence, engine);
    EXPECT_EQ(made.result.frames.size(), sequence.frames.size());
    EXPECT_TRUE(std::isfinite(made.result.noise_sigma));
    for (const Snapshot& snapshot : made.snapshots) {
      for (std::size_t i = 0; i < snapshot.scene.intensity.pixels().size(); ++i) {
        ASSERT_TRUE(std::isfinite(snapshot.scene.intensity.pixels()[i])) << "seed " << seed;
        ASSERT_TRUE(std::isfinite(snapshot.scene.information.pixels()[i])) << "seed " << seed;
      }
    }
    for (const SegmentResult& segment : made.result.segments) {
      for (const ChainEntry& entry : segment.chain) {
        EXPECT_TRUE(entry.registration.view.scene_from_sensor.linear.allFinite()) << "seed " << seed;
        EXPECT_TRUE(entry.registration.view.scene_from_sensor.offset.allFinite()) << "seed " << seed;
        EXPECT_TRUE(std::isfinite(entry.registration.view.gain) && std::isfinite(entry.registration.view.offset)) << "seed " << seed;
        EXPECT_TRUE(entry.registration.corner_covariance.allFinite()) << "seed " << seed;
        EXPECT_TRUE(std::isfinite(entry.registration.residual_rms)) << "seed " << seed;
      }
    }
    for (const FrameReport& report : made.result.frames) {
      const bool used = report.outcome == Outcome::kRegistered || report.outcome == Outcome::kStartedScene;
      EXPECT_TRUE(used || !report.reason.empty()) << "seed " << seed;
    }
  }
}

}  // namespace
}  // namespace trem
