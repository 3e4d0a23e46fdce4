// Goal: a detector's fixed pattern, its bad pixels and what moves in the scene are found, told and kept out of the scene; and nothing is
// found where nothing is. Method: rendered sequences with known faults; the engine with its corrections against the engine without.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <set>

#include "mosaic/base/rng.h"
#include "tests/support/rendered_sequence.h"
#include "tests/support/sensor_faults.h"
#include "tests/unit/worker/tre/mapped.h"
#include "worker/sensor/bicubic.h"
#include "worker/tre/detector_bias.h"
#include "worker/tre/mapping_engine.h"
#include "worker/tre/mover_mask.h"

namespace trem {
namespace {

using testing::RenderedSequence;
using testing::SequenceOptions;

SequenceOptions Brisk() {
  SequenceOptions options;
  options.frame_count = 32;
  options.roi_px = 71;
  options.speed_px = 1.5;
  return options;
}

const RenderedSequence& Clean() {
  static const RenderedSequence sequence = testing::RenderSequence(Brisk());
  return sequence;
}

EngineOptions Off() {
  EngineOptions options;
  options.detector_bias = options.mover_mask = Correction::kOff;
  return options;
}

EngineOptions Masking() {
  EngineOptions options;
  options.mover_mask = Correction::kOn;
  return options;
}

double MedianCornerError(const RenderedSequence& sequence, const Made& made) {
  std::vector<double> errors;
  for (const ChainEntry& entry : made.result.segments[0].chain) errors.push_back(testing::CornerError(sequence, entry, 0));
  std::nth_element(errors.begin(), errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2), errors.end());
  return errors[errors.size() / 2];
}

// Rms error of the last snapshot in truth cells within `reach` sensor px of a sensor point of frame `frame`; cells seen by 6 frames or
// more.
double ErrorNear(const RenderedSequence& sequence, const Image<float>& filtered, const Made& made, int frame, double x, double y,
                 double reach) {
  const SceneSnapshot& snapshot = made.snapshots.back().scene;
  const Affine scene_from_truth = sequence.TruthFromScene(0).Inverse();
  const Affine sensor_from_truth = sequence.truth_from_sensor[static_cast<std::size_t>(frame)].Inverse();
  double squares = 0.0;
  int count = 0;
  for (int j = 1; j + 1 < filtered.height(); ++j) {
    for (int i = 1; i + 1 < filtered.width(); ++i) {
      const Eigen::Vector2d sensor = sensor_from_truth * Eigen::Vector2d(i, j);
      if (std::max(std::abs(sensor.x() - x), std::abs(sensor.y() - y)) > reach) continue;
      const Eigen::Vector2d cell = scene_from_truth * Eigen::Vector2d(i, j) - Eigen::Vector2d(snapshot.extent.x0, snapshot.extent.y0);
      if (!CubicSupported(snapshot.intensity, cell.x(), cell.y())) continue;
      if (snapshot.information.at(static_cast<int>(cell.x() + 0.5), static_cast<int>(cell.y() + 0.5)) < 6.0F) continue;
      squares += std::pow(SampleCubic(snapshot.intensity, cell.x(), cell.y()) - filtered.at(i, j), 2);
      ++count;
    }
  }
  TREM_CHECK_MSG(count > 50, "too few cells to judge");
  return std::sqrt(squares / count);
}

const EngineNote* NoteOf(const Made& made, const std::string& code) {
  for (const EngineNote& note : made.result.notes) {
    if (note.code == code) return &note;
  }
  return nullptr;
}

TEST(DetectorBias, APatternThatPullsTheRegistrationIsFoundAndRemoved) {
  RenderedSequence sequence = Clean();
  testing::AddFixedPattern(4.0, 3, &sequence);
  const Made plain = Map(sequence, Off());
  const Made made = Map(sequence);
  ASSERT_NE(NoteOf(made, "detector_bias"), nullptr);
  EXPECT_EQ(NoteOf(plain, "detector_bias"), nullptr);
  EXPECT_LT(MedianCornerError(sequence, made), 0.7 * MedianCornerError(sequence, plain));
  const Image<float> filtered = testing::Filtered121(sequence.truth);
  const auto score = [&](const Made& m) {
    return testing::ScoreSnapshot(sequence, filtered, m.snapshots.back().scene, 0, 6.0, 1e9).scene_db;
  };
  ASSERT_TRUE(score(made) && score(plain));
  EXPECT_GT(*score(made), *score(plain) + 0.5);
}

TEST(DetectorBias, CleanFramesHaveNone) {
  const Made made = Map(Clean());
  EXPECT_THAT(made.result.notes, ::testing::IsEmpty());
}

// Over a still scene pattern and scene are one: ON must do nothing, not invent.
TEST(DetectorBias, AStillCameraIsLeftAlone) {
  SequenceOptions still = Brisk();
  RenderedSequence sequence = Clean();
  sequence.frames.resize(16);
  for (std::size_t k = 0; k < sequence.frames.size(); ++k) {
    sequence.frames[k].pixels = testing::RenderFrame(sequence.truth, still, sequence.truth_from_sensor[0], 1.0, 0.0, k);
    if (k > 0) sequence.frames[k].previous_from_current = Affine{};
  }
  testing::AddFixedPattern(4.0, 3, &sequence);
  EngineOptions on;
  on.detector_bias = Correction::kOn;
  const Made made = Map(sequence, on);
  const Made plain = Map(sequence, Off());
  EXPECT_EQ(NoteOf(made, "detector_bias"), nullptr);
  ASSERT_EQ(made.snapshots.size(), plain.snapshots.size());
  for (std::size_t i = 0; i < made.snapshots[0].scene.intensity.pixels().size(); ++i) {
    ASSERT_EQ(made.snapshots[0].scene.intensity.pixels()[i], plain.snapshots[0].scene.intensity.pixels()[i]);
  }
}

// The gauge: an image's mean over 17 x 17 pixels is gone, a pattern of single pixels stays, NaN is no pattern.
TEST(DetectorBias, TheGaugeTakesWhatGainOffsetAndSceneOwn) {
  Rng rng({1});
  Image<float> image(80, 60);
  Image<float> pattern(80, 60);
  for (int y = 0; y < 60; ++y) {
    for (int x = 0; x < 80; ++x) {
      pattern.at(x, y) = static_cast<float>(rng.Normal());
      image.at(x, y) = pattern.at(x, y) + 30.0F + 0.5F * static_cast<float>(x) - 0.2F * static_cast<float>(y);
    }
  }
  image.at(40, 30) = std::numeric_limits<float>::quiet_NaN();
  RemoveLocalMean(8, &image);
  EXPECT_EQ(image.at(40, 30), 0.0F);
  for (int y = 8; y < 52; ++y) {
    for (int x = 8; x < 72; ++x) {
      if (x == 40 && y == 30) continue;
      EXPECT_NEAR(image.at(x, y), pattern.at(x, y), 0.3F) << x << ", " << y;
    }
  }
}

// As tests/bench/real_sensor_quality: a ROI large enough for some dozens of bad pixels, scored where 12 frames or more have looked.
RenderedSequence WideClean() {
  SequenceOptions options;
  options.frame_count = 40;
  options.roi_px = 101;
  options.speed_px = 1.9;
  return testing::RenderSequence(options);
}

double ScoreOf(const RenderedSequence& clean, const Made& made) {
  return testing::ScoreSnapshot(clean, testing::Filtered121(clean.truth), made.snapshots.back().scene, 0, 12.0, 1e9).scene_db.value_or(0.0);
}

TEST(BadPixels, DeadHotStuckAndBlinkingPixelsAreFoundAndNoOthers) {
  const RenderedSequence clean = WideClean();
  const double clean_db = ScoreOf(clean, Map(clean, Off()));
  const std::vector<std::uint64_t> seeds = {3, 5, 7, 9};
  for (const std::uint64_t seed : seeds) {
    RenderedSequence sequence = clean;
    const std::vector<int> placed = testing::AddBadPixels(0.005, seed, &sequence);
    const Made made = Map(sequence);
    const std::set<int> truth(placed.begin(), placed.end());
    int hit = 0;
    int wrong = 0;
    for (const int index : made.result.bad_pixels) (truth.count(index) > 0 ? hit : wrong) += 1;
    EXPECT_GE(hit, static_cast<int>(0.85 * static_cast<double>(truth.size())));
    EXPECT_LE(wrong, 1);
    ASSERT_NE(NoteOf(made, "bad_pixels"), nullptr);
    EXPECT_GT(ScoreOf(clean, made), clean_db - 0.1) << "as good as without bad pixels; seed " << seed;
  }
}

// Huber's weights about the final scene spare it nearly all of a few bad pixels by themselves, but not of many.
TEST(BadPixels, ManyAreWorthCorrecting) {
  const RenderedSequence clean = WideClean();
  const std::vector<std::uint64_t> seeds = {3, 5, 7, 9};
  double gain_db = 0.0;
  for (const std::uint64_t seed : seeds) {
    RenderedSequence sequence = clean;
    testing::AddBadPixels(0.02, seed, &sequence);
    const Made plain = Map(sequence, Off());
    EXPECT_TRUE(plain.result.bad_pixels.empty());
    gain_db += (ScoreOf(clean, Map(sequence)) - ScoreOf(clean, plain)) / static_cast<double>(seeds.size());
  }
  EXPECT_GT(gain_db, 1.0);
}

// Less than 1 % of the pixels of clean frames are taken for movers: edges, aliasing and bars included.
TEST(MoverMask, CleanFramesAreNotEaten) {
  const Made made = Map(Clean(), Masking());
  EXPECT_LT(static_cast<double>(made.result.masked_pixels), 0.01 * static_cast<double>(made.result.used_pixels));
}

// A mover that stood in the scene's first frames leaves it, and takes its trace along.
TEST(MoverMask, AMoverOfTheFirstFramesLeavesNoGhost) {
  RenderedSequence sequence = Clean();
  // Goes slowly over the ground until it is gone in frame 14: in fewer frames, robust weights about the final scene are enough.
  testing::AddMover({13.0, 240.0, 45.0, 35.0, -0.5, 0.3, 0, 14}, &sequence);
  const Image<float> filtered = testing::Filtered121(sequence.truth);
  const Made plain = Map(sequence, Off());
  const Made made = Map(sequence, Masking());
  const Made clean = Map(Clean(), Masking());
  const double before = ErrorNear(sequence, filtered, plain, 3, 42.0, 37.0, 9.0);
  const double after = ErrorNear(sequence, filtered, made, 3, 42.0, 37.0, 9.0);
  const double best = ErrorNear(sequence, filtered, clean, 3, 42.0, 37.0, 9.0);
  EXPECT_GT(before, 2.0 * best) << "the mover has to have left something for this test to mean anything";
  // Of what the mover adds to the error, which falls when the unmasked engine forgets it faster, too.
  EXPECT_LT(after - best, 0.13 * (before - best)) << after << ", " << before << " without the mask, " << best << " without the mover";
  EXPECT_EQ(made.result.segments.size(), 1U);
}

TEST(MoverMask, AMoverThatCrossesTheSceneNeitherBlursItNorBendsTheViews) {
  RenderedSequence sequence = Clean();
  testing::AddMover({17.0, 235.0, 10.0, 25.0, 2.2, 0.8, 8, 32}, &sequence);
  const Image<float> filtered = testing::Filtered121(sequence.truth);
  const Made made = Map(sequence, Masking());
  const Made clean = Map(Clean(), Masking());
  ASSERT_NE(NoteOf(made, "movers_masked"), nullptr);
  EXPECT_LT(MedianCornerError(sequence, made), 1.3 * MedianCornerError(sequence, clean) + 0.005);
  // Where it was in frame 14; the scene has been seen often before and after.
  EXPECT_LT(ErrorNear(sequence, filtered, made, 14, 23.0, 30.0, 9.0),
            1.3 * ErrorNear(sequence, filtered, clean, 14, 23.0, 30.0, 9.0) + 0.5);
}

}  // namespace
}  // namespace trem
