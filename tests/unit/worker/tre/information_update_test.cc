// Goal: an iteration never makes the scene worse, samples land where they belong, and what is not a measurement leaves no trace.
// Method: with no momentum every step minimises a majoriser, so the objective (computed here in double precision from the header's
// formula) must not grow, whatever the kind of PSF; the step against finite differences of the objective; frames with NaN and with an
// outlier against frames without.
#include "worker/tre/information_update.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <string>

#include "mosaic/base/rng.h"
#include "tests/support/simd_targets.h"
#include "tests/unit/worker/sensor/sample_psfs.h"

namespace trem {
namespace {

constexpr int kRatio = 3;
const Roi kRoi{0, 0, 20, 18};
const Roi kPlane{-9, -9, 69, 63};

trem::Psf Psf() { return *MakePsf({0.55, 0.9}, kRatio); }

Image<float> NoisyFrame(std::uint64_t seed) {
  Rng rng({seed});
  Image<float> frame(kRoi.width(), kRoi.height());
  for (int y = 0; y < frame.height(); ++y) {
    for (int x = 0; x < frame.width(); ++x) {
      frame.at(x, y) = static_cast<float>(((x / 4 + y / 5) % 2 == 0 ? 60.0 : 150.0) + 2.0 * rng.Normal());
    }
  }
  return frame;
}

View ViewOf(double dx, double dy) {
  View view;
  view.scene_from_sensor.linear *= kRatio;
  view.scene_from_sensor.offset = {dx, dy};
  return view;
}

// A flat scene with six frames added at various places; some cells stay unseen.
SceneBuffer BufferWithFrames(InformationUpdate* update) {
  SceneBuffer buffer(kPlane);
  for (float& cell : buffer.scene.pixels()) cell = 100.0F;
  buffer.previous = buffer.scene;
  update->Predict(kPlane, &buffer);
  Rng rng({99});
  for (std::uint64_t k = 0; k < 6; ++k) {
    const Image<float> frame = NoisyFrame(k);
    update->AddFrame({&frame, kRoi, 2.0}, ViewOf(3.0 * rng.Uniform(), 3.0 * rng.Uniform()), kPlane, &buffer);
  }
  update->UpdateSeen(kPlane, kRatio, &buffer);
  return buffer;
}

double Objective(const SceneBuffer& buffer, const StructurePrior& prior, double lambda, const trem::Psf& psf = Psf()) {
  Blur blur(psf);
  Image<float> predicted(buffer.scene.width(), buffer.scene.height());
  blur.Apply(buffer.scene, &predicted);
  const auto psi = [&](double d) {
    const double size = std::abs(d);
    const bool linear = prior.kind == StructurePriorKind::kHuberTv && size > prior.delta;
    return linear ? prior.delta * (size - 0.5 * prior.delta) : 0.5 * d * d;
  };
  double sum = 0.0;
  for (int y = 0; y < predicted.height(); ++y) {
    for (int x = 0; x < predicted.width(); ++x) {
      const double w = buffer.weight.at(x, y);
      if (w > 0.0) sum += 0.5 * w * std::pow(predicted.at(x, y) - buffer.weighted.at(x, y) / w, 2);
      if (x > 0) sum += lambda * psi(buffer.scene.at(x, y) - buffer.scene.at(x - 1, y));
      if (y > 0) sum += lambda * psi(buffer.scene.at(x, y) - buffer.scene.at(x, y - 1));
    }
  }
  return sum;
}

TEST(InformationUpdate, AStepWithoutMomentumNeverIncreasesTheObjective) {
  for (const StructurePriorKind kind : {StructurePriorKind::kHuberTv, StructurePriorKind::kMembrane}) {
    for (const float lambda : {0.0F, 0.02F, 1.0F}) {
      InformationOptions options;
      options.prior.kind = kind;
      options.momentum_max = 0.0;
      InformationUpdate update(Blur(Psf()), options);
      SceneBuffer buffer = BufferWithFrames(&update);
      const double start = Objective(buffer, options.prior, lambda);
      double before = start;
      for (int step = 0; step < 30; ++step) {
        update.Iterate(kPlane, 1, lambda, &buffer);
        const double after = Objective(buffer, options.prior, lambda);
        ASSERT_LE(after, before * (1.0 + 1e-5)) << "step " << step << " lambda " << lambda;
        before = after;
      }
      EXPECT_LT(before, 0.6 * start) << "it does descend";
    }
  }
}

// PSFs of several separable terms, some of them not symmetric, and random ones: the second blur must be the adjoint of the first and the
// majoriser must bound what the terms leave below 0, or this goes up somewhere.
TEST(InformationUpdate, AStepNeverIncreasesTheObjectiveWhateverThePsf) {
  std::map<std::string, trem::Psf> psfs = SamplePsfs();
  Rng rng({31});
  for (int k = 0; k < 3; ++k) {
    Eigen::MatrixXd kernel(9, 9);
    for (int j = 0; j < 9; ++j) {
      for (int i = 0; i < 9; ++i) kernel(j, i) = std::pow(rng.Uniform(), 4) * std::exp(-0.08 * ((i - 4) * (i - 4) + (j - 4) * (j - 4)));
    }
    psfs["random " + std::to_string(k)] = DecomposeKernel(kernel);
  }
  for (const auto& [name, psf] : psfs) {
    InformationOptions options;
    options.momentum_max = 0.0;
    InformationUpdate update(Blur(psf), options);
    SceneBuffer buffer = BufferWithFrames(&update);
    const double start = Objective(buffer, options.prior, 0.02, psf);
    double before = start;
    for (int step = 0; step < 25; ++step) {
      update.Iterate(kPlane, 1, 0.02F, &buffer);
      const double after = Objective(buffer, options.prior, 0.02, psf);
      ASSERT_LE(after, before * (1.0 + 1e-5)) << name << ", step " << step;
      before = after;
    }
    EXPECT_LT(before, 0.8 * start) << name;
  }
}

TEST(InformationUpdate, TheStepFollowsTheTrueGradientOfAnAsymmetricPsf) {
  const trem::Psf psf = SamplePsfs().at("asymmetric file");
  InformationOptions options;
  options.momentum_max = 0.0;
  InformationUpdate update(Blur(psf), options);
  const SceneBuffer start = BufferWithFrames(&update);
  SceneBuffer moved = start;
  update.Iterate(kPlane, 1, 0.0F, &moved);
  // Inside, at borders and in a corner of the buffer, where B' folds back what B reflected.
  for (const auto& [x, y] : {std::pair{30, 28}, {35, 40}, {20, 33}, {12, 9}, {9, 30}, {0, 0}, {77, 30}}) {
    const double gradient = (start.scene.at(x, y) - moved.scene.at(x, y)) * (start.majoriser.at(x, y) + 1e-6);
    constexpr float kStep = 4.0F;
    SceneBuffer up = start;
    SceneBuffer down = start;
    up.scene.at(x, y) += kStep;
    down.scene.at(x, y) -= kStep;
    const double difference = (Objective(up, options.prior, 0.0, psf) - Objective(down, options.prior, 0.0, psf)) / (2.0 * kStep);
    EXPECT_NEAR(gradient, difference, 2e-3 * std::abs(difference) + 0.02) << x << ", " << y;
  }
}

TEST(InformationUpdate, MomentumGetsFurtherInTheSameSteps) {
  double reached[2];
  for (int k = 0; k < 2; ++k) {
    InformationOptions options;
    options.momentum_max = k == 0 ? 0.0 : 0.9;
    InformationUpdate update(Blur(Psf()), options);
    SceneBuffer buffer = BufferWithFrames(&update);
    update.Iterate(kPlane, 30, 0.02F, &buffer);
    reached[k] = Objective(buffer, options.prior, 0.02);
  }
  EXPECT_LT(reached[1], reached[0]);
}

TEST(InformationUpdate, NanPixelsLeaveNoTrace) {
  const InformationUpdate update(Blur(Psf()), {});
  SceneBuffer buffer(kPlane);
  Image<float> frame(kRoi.width(), kRoi.height(), std::numeric_limits<float>::quiet_NaN());
  frame.at(7, 5) = 80.0F;
  update.AddFrame({&frame, kRoi, 2.0}, ViewOf(0.2, -0.3), kPlane, &buffer);
  for (int y = 0; y < buffer.weight.height(); ++y) {
    for (int x = 0; x < buffer.weight.width(); ++x) {
      const bool hit = x + kPlane.x0 == 21 && y + kPlane.y0 == 15;
      EXPECT_EQ(buffer.weight.at(x, y), hit ? 1.0F : 0.0F);
      EXPECT_EQ(buffer.weighted.at(x, y), hit ? 80.0F : 0.0F);
    }
  }
}

TEST(InformationUpdate, AnOutlierOnKnownGroundLosesWeight) {
  InformationUpdate update(Blur(Psf()), {});
  SceneBuffer buffer(kPlane);
  for (float& cell : buffer.scene.pixels()) cell = 100.0F;
  update.Predict(kPlane, &buffer);
  Image<float> frame(kRoi.width(), kRoi.height(), 100.0F);
  for (int k = 0; k < 3; ++k) update.AddFrame({&frame, kRoi, 2.0}, ViewOf(k, 0.0), kPlane, &buffer);
  update.UpdateSeen(kPlane, kRatio, &buffer);
  const int x = 3 * 9 - kPlane.x0;
  const int y = 3 * 9 - kPlane.y0;
  const float before = buffer.weight.at(x, y);
  frame.at(9, 9) = 160.0F;  // Ten times the limit of 3 sigma.
  update.AddFrame({&frame, kRoi, 2.0}, ViewOf(0.0, 0.0), kPlane, &buffer);
  EXPECT_NEAR(buffer.weight.at(x, y) - before, 0.1F, 0.01F);
}

TEST(InformationUpdate, ForgettingFadesTheRegionOnly) {
  InformationOptions options;
  options.forgetting = 0.5;
  const InformationUpdate update(Blur(Psf()), options);
  SceneBuffer buffer(kPlane);
  for (float& cell : buffer.weight.pixels()) cell = 1.0F;
  const Image<float> nothing(kRoi.width(), kRoi.height(), std::numeric_limits<float>::quiet_NaN());
  const Roi region{0, 0, 10, 10};
  update.AddFrame({&nothing, kRoi, 2.0}, ViewOf(0.0, 0.0), region, &buffer);
  EXPECT_EQ(buffer.weight.at(5 - kPlane.x0, 5 - kPlane.y0), 0.5F);
  EXPECT_EQ(buffer.weight.at(15 - kPlane.x0, 5 - kPlane.y0), 1.0F);
}

// Several frames and iterations on a moving region, as a segment does it.
SceneBuffer BufferAfterFrames(const InformationOptions& options) {
  InformationUpdate update(Blur(Psf()), options);
  SceneBuffer buffer(kPlane);
  for (float& cell : buffer.scene.pixels()) cell = 100.0F;
  buffer.previous = buffer.scene;
  Rng rng({98});
  for (std::uint64_t k = 0; k < 6; ++k) {
    const Image<float> frame = NoisyFrame(k);
    View view = ViewOf(3.0 * rng.Uniform(), 3.0 * rng.Uniform());
    view.scene_from_sensor.linear(0, 1) = 0.1;
    view.scene_from_sensor.linear(1, 0) = -0.1;
    if (k % 2 == 1) view.scene_from_sensor.perspective = {2e-3, -1e-3};
    const Roi region{kPlane.x0 + static_cast<int>(k), kPlane.y0, kPlane.x1, kPlane.y1 - static_cast<int>(k)};
    update.Predict(region, &buffer);
    update.AddFrame({&frame, kRoi, 2.0}, view, region, &buffer);
    update.UpdateSeen(region, kRatio, &buffer);
    update.Iterate(region, static_cast<int>(k), 0.02F, &buffer);
  }
  return buffer;
}

void ExpectSameBytes(const SceneBuffer& a, const SceneBuffer& b, const std::string& what) {
  for (const auto plane : {&SceneBuffer::scene, &SceneBuffer::previous, &SceneBuffer::weight, &SceneBuffer::weighted,
                           &SceneBuffer::prediction, &SceneBuffer::majoriser, &SceneBuffer::seen}) {
    const auto in_a = (a.*plane).pixels();
    const auto in_b = (b.*plane).pixels();
    EXPECT_TRUE(std::equal(in_a.begin(), in_a.end(), in_b.begin(), in_b.end())) << what;
  }
}

TEST(InformationUpdate, ThreadsDoNotChangeAByte) {
  InformationOptions options;
  options.forgetting = 0.98;
  const SceneBuffer one = BufferAfterFrames(options);
  for (const int threads : {2, 4}) {
    options.threads = threads;
    ExpectSameBytes(one, BufferAfterFrames(options), std::to_string(threads) + " threads");
  }
}

TEST(InformationUpdate, EveryTargetWithFusedMultiplyAddGivesTheSameBytes) {
  const std::vector<std::int64_t> targets = testing::FusedTargets();
  if (targets.size() < 2) GTEST_SKIP() << "needs a processor with AVX2 and AVX-512";
  InformationOptions options;
  options.forgetting = 0.98;
  const SceneBuffer best = BufferAfterFrames(options);
  for (const std::int64_t target : targets) {
    const testing::WithTarget chosen(target);
    ExpectSameBytes(best, BufferAfterFrames(options), hwy::TargetName(target));
  }
}

TEST(InformationUpdate, TheSweepIsTheIterationInPassesWithinRounding) {
  for (const StructurePriorKind kind : {StructurePriorKind::kHuberTv, StructurePriorKind::kMembrane}) {
    InformationOptions options;
    options.prior.kind = kind;
    const SceneBuffer fused = BufferAfterFrames(options);
    options.fused = false;
    const SceneBuffer passes = BufferAfterFrames(options);
    for (int y = 0; y < fused.scene.height(); ++y) {
      for (int x = 0; x < fused.scene.width(); ++x) {
        ASSERT_NEAR(fused.scene.at(x, y), passes.scene.at(x, y), 2e-3) << x << ", " << y;
        ASSERT_NEAR(fused.previous.at(x, y), passes.previous.at(x, y), 2e-3) << x << ", " << y;
        ASSERT_NEAR(fused.prediction.at(x, y), passes.prediction.at(x, y), 2e-3) << x << ", " << y;
      }
    }
  }
}

TEST(InformationUpdate, SeenIsTheTentsSumUnlessTheSamplesAreFar) {
  InformationUpdate update(Blur(Psf()), {});
  SceneBuffer buffer(kPlane);
  Rng rng({97});
  for (float& cell : buffer.weight.pixels()) cell = rng.Uniform() < 0.3 ? static_cast<float>(12.0 * rng.Uniform()) : 0.0F;
  // Ground that was seen beside ground that was not.
  for (int y = 0; y < buffer.weight.height(); ++y) std::fill(buffer.weight.row(y) + 30, buffer.weight.row(y) + 45, 0.0F);
  for (const Roi& region : {kPlane, Roi{0, 0, 40, 30}}) {
    std::fill(buffer.seen.pixels().begin(), buffer.seen.pixels().end(), -1.0F);
    update.UpdateSeen(region, kRatio, &buffer);
    const Roi inner = buffer.InBuffer(region);
    int judged_unseen = 0;
    for (int y = 0; y < buffer.seen.height(); ++y) {
      for (int x = 0; x < buffer.seen.width(); ++x) {
        double expected = -1.0;
        if (inner.Contains(x, y)) {
          double about = 0.0;
          expected = 0.0;
          for (int j = -2; j <= 2; ++j) {
            for (int i = -2; i <= 2; ++i) {
              if (!Roi({0, 0, buffer.weight.width(), buffer.weight.height()}).Contains(x + i, y + j)) continue;
              expected += (3 - std::abs(i)) * (3 - std::abs(j)) / 9.0 * static_cast<double>(buffer.weight.at(x + i, y + j));
              if (std::abs(i) <= 1 && std::abs(j) <= 1) about += static_cast<double>(buffer.weight.at(x + i, y + j));
            }
          }
          if (expected >= 3.0 && about < 0.25 * expected) {
            expected = 0.0;
            ++judged_unseen;
          }
        }
        ASSERT_NEAR(buffer.seen.at(x, y), expected, 1e-4) << x << ", " << y;
      }
    }
    EXPECT_GT(judged_unseen, 5) << "the case tests something";
  }
}

}  // namespace
}  // namespace trem
