// Goal: the automatic weight follows the scene's contrast and the noise, moves towards what predicts the next frame better, and ends
// close to the best weight. Method: scenes and frames made by hand for the first two; a sweep of factors on a rendered sequence for the
// last (tests/bench/regularisation_sweep does it for many scenes).
#include "worker/tre/automatic_regularisation.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "mosaic/base/rng.h"
#include "tests/support/rendered_sequence.h"
#include "worker/sensor/forward_operator.h"

namespace trem {
namespace {

constexpr int kRatio = 3;
const Roi kPlane{0, 0, 180, 180};
const Roi kSensor{0, 0, 60, 60};

Psf Gaussian() { return *MakePsf({0.55, 0.9}, kRatio); }

// Squares and noise of one cell.
Image<float> MakeScene(double contrast, double noise) {
  Rng rng({5});
  Image<float> scene(kPlane.width(), kPlane.height());
  for (int y = 0; y < scene.height(); ++y) {
    for (int x = 0; x < scene.width(); ++x) {
      scene.at(x, y) = static_cast<float>(100.0 + ((x / 9 + y / 9) % 2 == 0 ? contrast : -contrast) + noise * rng.Normal());
    }
  }
  return scene;
}

// A buffer whose data agree with its scene: what the prior does not like in it, only the prior changes.
SceneBuffer BufferOf(const Image<float>& scene, float frames) {
  SceneBuffer buffer(kPlane);
  buffer.scene = scene;
  buffer.previous = scene;
  Blur blur(Gaussian());
  blur.Apply(scene, &buffer.prediction);
  for (std::size_t i = 0; i < scene.pixels().size(); ++i) {
    buffer.weight.pixels()[i] = frames / 9.0F;
    buffer.weighted.pixels()[i] = buffer.weight.pixels()[i] * buffer.prediction.pixels()[i];
    buffer.majoriser.pixels()[i] = frames / 9.0F;
    buffer.seen.pixels()[i] = frames;
  }
  return buffer;
}

View NominalView() {
  View view;
  view.scene_from_sensor.linear *= kRatio;
  return view;
}

// log f after `frames` frames of `truth` were held against probes of a buffer that holds `scene`.
double LearntFactor(const Image<float>& scene, const Image<float>& truth, int frames) {
  AutomaticRegularisation automatic(Gaussian(), StructurePriorKind::kHuberTv, kRatio);
  const SceneBuffer buffer = BufferOf(scene, 4.0F);
  Affine scene_from_sensor;
  scene_from_sensor.linear *= kRatio;
  const Image<float> exact = ForwardOperator(Gaussian(), scene_from_sensor, kSensor.width(), kSensor.height()).Apply(truth);
  for (int t = 0; t < frames; ++t) {
    Rng rng({6, static_cast<std::uint64_t>(t)});
    Image<float> frame = exact;
    for (float& pixel : frame.pixels()) pixel += static_cast<float>(2.0 * rng.Normal());
    automatic.MakeProbe(kPlane, buffer, 2.0);
    automatic.Learn({&frame, kSensor, 2.0}, NominalView());
  }
  return automatic.log_factor();
}

TEST(AutomaticRegularisation, ASceneOfTwiceTheContrastUnderTwiceTheNoiseGetsTheSameWeight) {
  const AutomaticRegularisation automatic(Gaussian(), StructurePriorKind::kHuberTv, kRatio);
  Image<float> scene = MakeScene(30.0, 3.0);
  const StructureWeight once = automatic.Weight(kPlane, BufferOf(scene, 4.0F), 2.0);
  for (float& cell : scene.pixels()) cell *= 2.0F;
  const StructureWeight twice = automatic.Weight(kPlane, BufferOf(scene, 4.0F), 4.0);
  EXPECT_NEAR(twice.lambda, once.lambda, 1e-3F * once.lambda);
  EXPECT_NEAR(twice.delta, 2.0F * once.delta, 1e-3F * once.delta);
}

TEST(AutomaticRegularisation, MoreContrastMeansLessWeightAndMoreNoiseMeansMore) {
  const AutomaticRegularisation automatic(Gaussian(), StructurePriorKind::kHuberTv, kRatio);
  const StructureWeight weak = automatic.Weight(kPlane, BufferOf(MakeScene(10.0, 1.0), 4.0F), 2.0);
  const StructureWeight strong = automatic.Weight(kPlane, BufferOf(MakeScene(60.0, 6.0), 4.0F), 2.0);
  const StructureWeight noisy = automatic.Weight(kPlane, BufferOf(MakeScene(60.0, 6.0), 4.0F), 6.0);
  EXPECT_LT(strong.lambda, 0.5F * weak.lambda);
  EXPECT_GT(noisy.lambda, 2.0F * strong.lambda);
}

TEST(AutomaticRegularisation, GroundWithoutTextureGetsAFiniteWeight) {
  const AutomaticRegularisation automatic(Gaussian(), StructurePriorKind::kHuberTv, kRatio);
  const Image<float> flat(kPlane.width(), kPlane.height(), 100.0F);
  for (const float frames : {0.0F, 1.0F, 100.0F}) {
    const StructureWeight weight = automatic.Weight(kPlane, BufferOf(flat, frames), 2.0);
    EXPECT_TRUE(std::isfinite(weight.lambda) && weight.lambda > 0.0F && weight.lambda < 100.0F);
    EXPECT_GT(weight.delta, 0.0F);
  }
}

TEST(AutomaticRegularisation, TheWeightFallsWhereSmoothingLosesWhatFramesShow) {
  const Image<float> truth = MakeScene(20.0, 12.0);
  EXPECT_LT(LearntFactor(truth, truth, 6), -0.2);
}

TEST(AutomaticRegularisation, TheWeightRisesWhereTheSceneHoldsWhatFramesDoNotShow) {
  EXPECT_GT(LearntFactor(MakeScene(20.0, 12.0), MakeScene(20.0, 0.0), 6), 0.2);
}

TEST(AutomaticRegularisation, FramesWithoutMeasurementsTeachNothing) {
  AutomaticRegularisation automatic(Gaussian(), StructurePriorKind::kHuberTv, kRatio);
  const SceneBuffer buffer = BufferOf(MakeScene(20.0, 12.0), 4.0F);
  const Image<float> nothing(kSensor.width(), kSensor.height(), std::numeric_limits<float>::quiet_NaN());
  automatic.MakeProbe(kPlane, buffer, 2.0);
  automatic.Learn({&nothing, kSensor, 2.0}, NominalView());
  EXPECT_EQ(automatic.log_factor(), 0.0);
}

TEST(AutomaticRegularisation, TheSceneIsWithinAFifthOfADecibelOfTheBestWeights) {
  testing::SequenceOptions options;
  options.frame_count = 16;
  options.speed_px = 0.2;
  const testing::RenderedSequence sequence = testing::RenderSequence(options);
  const Image<float> filtered = testing::Filtered121(sequence.truth);
  double automatic_db = 0.0;
  double best_db = 0.0;
  for (const double factor : {0.2, 0.5, 1.0, 2.0, 5.0}) {
    EngineOptions engine;
    engine.structure_weight = factor;
    double db = 0.0;
    const SnapshotSink sink = [&](int, const SceneSnapshot& snapshot) {
      db = testing::ScoreSnapshot(sequence, filtered, snapshot, 0, 0.4, 1e9).scene_db.value_or(0.0);
      return Status{};
    };
    ASSERT_TRUE(RunMapping(sequence.roi, sequence.frames, engine, sink, {}).ok());
    best_db = std::max(best_db, db);
    if (factor == 1.0) automatic_db = db;
  }
  EXPECT_GT(automatic_db, best_db - 0.2);
}

}  // namespace
}  // namespace trem
