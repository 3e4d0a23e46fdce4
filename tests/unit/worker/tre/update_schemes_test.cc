// Goal: LANDWEBER and POINTWISE descend on the objectives that their headers state, end where the converged batch solution of the same
// problem does, go on when the buffer moves over the ground, and give the same bytes twice. Method: a small scene seen by frames whose
// samples lie on cells, so that the accumulated samples and the frames themselves state one objective (computed here in double
// precision); tests/support/batch_map is the reference.
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>

#include "mosaic/base/rng.h"
#include "tests/support/batch_map.h"
#include "worker/tre/information_update.h"
#include "worker/tre/landweber_update.h"
#include "worker/tre/pointwise_update.h"

namespace trem {
namespace {

constexpr int kRatio = 3;
constexpr int kFrames = 5;
constexpr float kLambda = 0.05F;
const Roi kRoi{0, 0, 14, 12};
const Roi kPlane{-10, -10, 52, 46};
constexpr StructurePriorKind kKinds[] = {StructurePriorKind::kHuberTv, StructurePriorKind::kMembrane, StructurePriorKind::kLaplacian,
                                         StructurePriorKind::kBilateralTv};

Psf Gaussian() { return *MakePsf({0.55, 0.9}, kRatio); }

View ViewOf(int dx, int dy) {
  View view;
  view.scene_from_sensor.linear *= kRatio;
  view.scene_from_sensor.offset = Eigen::Vector2d(dx, dy);
  return view;
}

struct Problem {
  std::vector<Image<float>> frames;
  std::vector<View> views;
  SceneBuffer buffer{kPlane};

  std::vector<testing::BatchFrame> batch() const {
    std::vector<testing::BatchFrame> list;
    for (std::size_t t = 0; t < frames.size(); ++t) list.push_back({{&frames[t], kRoi, 2.0}, views[t]});
    return list;
  }
};

// Frames at whole cells: the samples lie where they are splatted to.
Problem MakeProblem(InformationUpdate* counts) {
  Problem problem;
  for (float& cell : problem.buffer.scene.pixels()) cell = 100.0F;
  problem.buffer.previous = problem.buffer.scene;
  counts->Predict(kPlane, &problem.buffer);
  for (int t = 0; t < kFrames; ++t) {
    Rng rng({7, static_cast<std::uint64_t>(t)});
    Image<float> frame(kRoi.width(), kRoi.height());
    for (int y = 0; y < frame.height(); ++y) {
      for (int x = 0; x < frame.width(); ++x)
        frame.at(x, y) = static_cast<float>(((x / 3 + y / 4) % 2 == 0 ? 80.0 : 120.0) + 2.0 * rng.Normal());
    }
    problem.frames.push_back(std::move(frame));
    problem.views.push_back(ViewOf(t % 3, (2 * t) % 3));
  }
  for (std::size_t t = 0; t < problem.frames.size(); ++t) {
    counts->AddFrame({&problem.frames[t], kRoi, 2.0}, problem.views[t], kPlane, &problem.buffer);
  }
  counts->UpdateSeen(kPlane, kRatio, &problem.buffer);
  return problem;
}

InformationOptions PlainCounts() {
  InformationOptions options;
  options.huber_sigmas = 1e6;
  return options;
}

Image<float> Reference(const Problem& problem, const StructurePrior& prior) {
  testing::BatchMapOptions options;
  options.prior = prior;
  options.weight = kLambda;
  options.iterations_max = 3000;
  options.tolerance = 1e-4;
  return testing::BatchMap(Gaussian(), kPlane, problem.batch(), options, problem.buffer.scene);
}

// The data term of the accumulated samples.
double Misfit(const SceneBuffer& buffer) {
  Blur blur(Gaussian());
  Image<float> predicted(buffer.scene.width(), buffer.scene.height());
  blur.Apply(buffer.scene, &predicted);
  double sum = 0.0;
  for (std::size_t i = 0; i < predicted.pixels().size(); ++i) {
    const double w = buffer.weight.pixels()[i];
    if (w > 0.0) sum += 0.5 * w * std::pow(predicted.pixels()[i] - buffer.weighted.pixels()[i] / w, 2);
  }
  return sum;
}

// Of HUBER_TV and MEMBRANE on the whole buffer.
double Objective(const SceneBuffer& buffer, const StructurePrior& prior) {
  const auto psi = [&](double d) {
    const double size = std::abs(d);
    return prior.kind == StructurePriorKind::kMembrane || size <= prior.delta ? 0.5 * d * d : prior.delta * (size - 0.5 * prior.delta);
  };
  double sum = Misfit(buffer);
  for (int y = 0; y < buffer.scene.height(); ++y) {
    for (int x = 0; x < buffer.scene.width(); ++x) {
      if (x > 0) sum += kLambda * psi(buffer.scene.at(x, y) - buffer.scene.at(x - 1, y));
      if (y > 0) sum += kLambda * psi(buffer.scene.at(x, y) - buffer.scene.at(x, y - 1));
    }
  }
  return sum;
}

// Well inside what frames have measured: beyond it the prior alone continues the scene, which takes for ever to settle.
double LargestDifference(const Image<float>& a, const Image<float>& b) {
  double largest = 0.0;
  for (int y = 20; y < a.height() - 20; ++y) {
    for (int x = 20; x < a.width() - 20; ++x) largest = std::max<double>(largest, std::abs(a.at(x, y) - b.at(x, y)));
  }
  return largest;
}

bool SameBytes(const Image<float>& a, const Image<float>& b) {
  return std::memcmp(a.pixels().data(), b.pixels().data(), a.pixels().size_bytes()) == 0;
}

LandweberUpdate LandweberWith(const Problem& problem) {
  LandweberUpdate update(Gaussian(), {.window = kFrames, .huber_sigmas = 1e6});
  for (std::size_t t = 0; t < problem.frames.size(); ++t) {
    update.AddFrame(static_cast<int>(t), {&problem.frames[t], kRoi, 2.0}, problem.views[t]);
  }
  // All frames are in the window, and no cell has been seen more often: the prior's part is 1.
  return update;
}

TEST(LandweberUpdate, NoStepRaisesTheObjective) {
  for (const StructurePriorKind kind : {StructurePriorKind::kHuberTv, StructurePriorKind::kMembrane}) {
    InformationUpdate counts(Blur(Gaussian()), PlainCounts());
    Problem problem = MakeProblem(&counts);
    LandweberUpdate update = LandweberWith(problem);
    const StructurePrior prior{kind, 4.0F};
    const double start = Objective(problem.buffer, prior);
    double before = start;
    for (int step = 0; step < 40; ++step) {
      update.Iterate(kPlane, 1, prior, kLambda, &problem.buffer);
      const double after = Objective(problem.buffer, prior);
      ASSERT_LE(after, before * (1.0 + 1e-6)) << "step " << step;
      before = after;
    }
    EXPECT_LT(before, 0.5 * start);
  }
}

TEST(PointwiseUpdate, NoSweepRaisesTheObjective) {
  for (const StructurePriorKind kind : {StructurePriorKind::kHuberTv, StructurePriorKind::kMembrane}) {
    InformationUpdate counts(Blur(Gaussian()), PlainCounts());
    Problem problem = MakeProblem(&counts);
    PointwiseUpdate update(Gaussian(), 1, 0);
    const StructurePrior prior{kind, 4.0F};
    const double start = Objective(problem.buffer, prior);
    double before = start;
    for (int sweep = 0; sweep < 15; ++sweep) {
      update.Iterate(kPlane, 1, prior, kLambda, &problem.buffer);
      const double after = Objective(problem.buffer, prior);
      ASSERT_LE(after, before * (1.0 + 1e-6)) << "sweep " << sweep;
      before = after;
    }
    EXPECT_LT(before, 0.5 * start);
  }
}

TEST(UpdateSchemes, AllEndAtTheBatchSolution) {
  for (const StructurePriorKind kind : kKinds) {
    const StructurePrior prior{kind, 4.0F};
    InformationUpdate counts(Blur(Gaussian()), PlainCounts());
    const Problem problem = MakeProblem(&counts);
    const Image<float> reference = Reference(problem, prior);
    EXPECT_GT(LargestDifference(problem.buffer.scene, reference), 10.0) << "the start is not the answer";

    SceneBuffer buffer = problem.buffer;
    LandweberUpdate landweber = LandweberWith(problem);
    landweber.Iterate(kPlane, 3000, prior, kLambda, &buffer);
    EXPECT_LT(LargestDifference(buffer.scene, reference), 0.15) << "LANDWEBER, kind " << static_cast<int>(kind);

    buffer = problem.buffer;
    PointwiseUpdate pointwise(Gaussian(), 1, 0);
    pointwise.Iterate(kPlane, 300, prior, kLambda, &buffer);
    EXPECT_LT(LargestDifference(buffer.scene, reference), 0.15) << "POINTWISE, kind " << static_cast<int>(kind);

    buffer = problem.buffer;
    counts.set_prior(prior);
    counts.Iterate(kPlane, 3000, kLambda, &buffer);
    EXPECT_LT(LargestDifference(buffer.scene, reference), 0.15) << "INFORMATION, kind " << static_cast<int>(kind);
  }
}

// Cells near the buffer's border feed samples through the reflection of the PSF: the book-keeping of the visits has to agree with the
// blur there too.
TEST(PointwiseUpdate, BorderCellsDescendToo) {
  InformationUpdate counts(Blur(Gaussian()), PlainCounts());
  Problem problem = MakeProblem(&counts);
  problem.buffer.MoveTo({1, 2, 37, 30});  // Samples right up to the border.
  counts.UpdateSeen(problem.buffer.extent, kRatio, &problem.buffer);
  const StructurePrior prior{StructurePriorKind::kMembrane, 4.0F};
  PointwiseUpdate update(Gaussian(), 1, 0);
  double before = Objective(problem.buffer, prior);
  for (int sweep = 0; sweep < 10; ++sweep) {
    update.Iterate(problem.buffer.extent, 1, prior, kLambda, &problem.buffer);
    const double after = Objective(problem.buffer, prior);
    ASSERT_LE(after, before * (1.0 + 1e-6));
    before = after;
  }
}

TEST(UpdateSchemes, TheBufferMayMoveOverTheGround) {
  InformationUpdate counts(Blur(Gaussian()), PlainCounts());
  const StructurePrior prior{StructurePriorKind::kHuberTv, 4.0F};
  const Roi moved{-10 + 6, -10 + 3, 52 + 6, 46 + 3};
  for (const bool pointwise : {false, true}) {
    // Moved before or after the steps: the same ground comes out where the moved buffer still has all that it depends on.
    Image<float> results[2];
    for (int k = 0; k < 2; ++k) {
      Problem problem = MakeProblem(&counts);
      LandweberUpdate landweber = LandweberWith(problem);
      PointwiseUpdate points(Gaussian(), 1, 0);
      UpdateScheme* scheme = pointwise ? static_cast<UpdateScheme*>(&points) : &landweber;
      const int steps = pointwise ? 200 : 2000;
      if (k == 0) {
        for (float& cell : problem.buffer.scene.pixels()) cell = 100.0F;
        problem.buffer.MoveTo(moved);
        for (int y = 0; y < problem.buffer.scene.height(); ++y) {
          for (int x = 0; x < problem.buffer.scene.width(); ++x) {
            if (problem.buffer.scene.at(x, y) == 0.0F) problem.buffer.scene.at(x, y) = 100.0F;
          }
        }
        counts.UpdateSeen(moved, kRatio, &problem.buffer);
      }
      scheme->Iterate(problem.buffer.extent, steps, prior, kLambda, &problem.buffer);
      if (k == 1) problem.buffer.MoveTo(moved);
      results[k] = problem.buffer.scene;
    }
    double largest = 0.0;
    for (int y = 20; y < 34; ++y) {
      for (int x = 20; x < 40; ++x) largest = std::max<double>(largest, std::abs(results[0].at(x, y) - results[1].at(x, y)));
    }
    EXPECT_LT(largest, 0.5) << (pointwise ? "POINTWISE" : "LANDWEBER");
  }
}

TEST(UpdateSchemes, TwoRunsGiveTheSameBytesAndTheSeedOrdersTheVisits) {
  InformationUpdate counts(Blur(Gaussian()), PlainCounts());
  const Problem problem = MakeProblem(&counts);
  const StructurePrior prior;
  Image<float> scenes[4];
  for (int k = 0; k < 4; ++k) {
    SceneBuffer buffer = problem.buffer;
    if (k < 3) {
      PointwiseUpdate(Gaussian(), k < 2 ? 1 : 2, 0).Iterate(kPlane, 2, prior, kLambda, &buffer);
    } else {
      LandweberWith(problem).Iterate(kPlane, 2, prior, kLambda, &buffer);
      SceneBuffer again = problem.buffer;
      LandweberWith(problem).Iterate(kPlane, 2, prior, kLambda, &again);
      EXPECT_TRUE(SameBytes(buffer.scene, again.scene));
    }
    scenes[k] = buffer.scene;
  }
  EXPECT_TRUE(SameBytes(scenes[0], scenes[1]));
  EXPECT_FALSE(SameBytes(scenes[0], scenes[2]));
}

TEST(LandweberUpdate, KeepsTheLastFramesOfItsWindow) {
  const Image<float> frame(kRoi.width(), kRoi.height(), 50.0F);
  LandweberUpdate update(Gaussian(), {.window = 3});
  for (int t = 0; t < 5; ++t) update.AddFrame(t, {&frame, kRoi, 2.0}, ViewOf(0, 0));
  ASSERT_EQ(update.kept_frames().size(), 3U);
  EXPECT_EQ(update.kept_frames().front().frame_index, 2);
  EXPECT_EQ(update.kept_frames().back().frame_index, 4);
}

}  // namespace
}  // namespace trem
