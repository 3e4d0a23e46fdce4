// Goal: AddGradient and SlopeAt are the slopes of the energies that the header states, within their region, and the curvature bounds
// hold. Method: finite differences of the energies, computed here in double precision from the stated sums; the bounds by steps on rough
// scenes, which must never raise the energy.
#include "worker/tre/structure_prior.h"

#include <gtest/gtest.h>

#include <cmath>

#include "mosaic/base/rng.h"

namespace trem {
namespace {

constexpr StructurePriorKind kKinds[] = {StructurePriorKind::kHuberTv, StructurePriorKind::kMembrane, StructurePriorKind::kLaplacian,
                                         StructurePriorKind::kBilateralTv};
const Roi kRegions[] = {{0, 0, 14, 11}, {3, 2, 10, 9}, {5, 5, 6, 9}, {5, 5, 9, 6}, {4, 4, 5, 5}, {4, 4, 6, 6}};

double Psi(bool huber, double delta, double d) {
  const double size = std::abs(d);
  return !huber || size <= delta ? 0.5 * d * d : delta * (size - 0.5 * delta);
}

double PairEnergy(const StructurePrior& prior, const Image<double>& scene, const Roi& region, int reach) {
  const bool bilateral = prior.kind == StructurePriorKind::kBilateralTv;
  const bool huber = prior.kind != StructurePriorKind::kMembrane;
  double sum = 0.0;
  for (int y = region.y0; y < region.y1; ++y) {
    for (int x = region.x0; x < region.x1; ++x) {
      for (int m = -reach; m <= reach; ++m) {
        for (int l = -reach; l <= reach; ++l) {
          if ((l == 0 && m == 0) || (!bilateral && l * m != 0) || !region.Contains(x + l, y + m)) continue;
          const double weight = bilateral ? std::pow(0.7, std::abs(l) + std::abs(m)) : 1.0;
          sum += 0.5 * weight * Psi(huber, prior.delta, scene.at(x, y) - scene.at(x + l, y + m));  // Both ends see the pair.
        }
      }
    }
  }
  return sum;
}

double Energy(const StructurePrior& prior, const Image<double>& scene, const Roi& region) {
  if (prior.kind == StructurePriorKind::kBilateralTv) return PairEnergy(prior, scene, region, 2);
  if (prior.kind != StructurePriorKind::kLaplacian) return PairEnergy(prior, scene, region, 1);
  double sum = 0.0;
  for (int y = region.y0; y < region.y1; ++y) {
    for (int x = region.x0; x < region.x1; ++x) {
      double bend = 0.0;
      for (const auto& [l, m] : {std::pair{-1, 0}, {1, 0}, {0, -1}, {0, 1}}) {
        if (region.Contains(x + l, y + m)) bend += scene.at(x, y) - scene.at(x + l, y + m);
      }
      sum += 0.5 * bend * bend;
    }
  }
  return sum;
}

struct Scene {
  Image<float> single{14, 11};
  Image<double> exact{14, 11};
};

Scene RandomScene(std::uint64_t seed, double spread) {
  Rng rng({seed});
  Scene scene;
  for (std::size_t i = 0; i < scene.single.pixels().size(); ++i) {
    scene.single.pixels()[i] = static_cast<float>(100.0 + spread * rng.Normal());
    scene.exact.pixels()[i] = scene.single.pixels()[i];
  }
  return scene;
}

// Central difference of the energy along one cell's axis.
double NumericSlope(const StructurePrior& prior, const Scene& scene, const Roi& region, int x, int y) {
  constexpr double kStep = 1e-4;
  Image<double> moved = scene.exact;
  moved.at(x, y) += kStep;
  const double above = Energy(prior, moved, region);
  moved.at(x, y) -= 2.0 * kStep;
  return (above - Energy(prior, moved, region)) / (2.0 * kStep);
}

TEST(StructurePrior, TheGradientIsThatOfTheEnergy) {
  constexpr float kWeight = 0.7F;
  const Scene scene = RandomScene(1, 5.0);
  for (const StructurePriorKind kind : kKinds) {
    for (const Roi& region : kRegions) {
      const StructurePrior prior{kind, 4.0F};
      Image<float> gradient(14, 11, 1.0F);
      prior.AddGradient(scene.single, region, kWeight, &gradient);
      for (int y = 0; y < 11; ++y) {
        for (int x = 0; x < 14; ++x) {
          const double slope = region.Contains(x, y) ? NumericSlope(prior, scene, region, x, y) : 0.0;
          ASSERT_NEAR(gradient.at(x, y), 1.0 + kWeight * slope, 2e-3)
              << x << ", " << y << " of " << ToString(region) << " kind " << static_cast<int>(kind);
        }
      }
    }
  }
}

TEST(StructurePrior, TheSlopeOfACellIsThatOfTheGradient) {
  const Scene scene = RandomScene(2, 5.0);
  for (const StructurePriorKind kind : kKinds) {
    for (const Roi& region : kRegions) {
      const StructurePrior prior{kind, 4.0F};
      Image<float> gradient(14, 11);
      prior.AddGradient(scene.single, region, 1.0F, &gradient);
      for (int y = region.y0; y < region.y1; ++y) {
        for (int x = region.x0; x < region.x1; ++x) ASSERT_NEAR(prior.SlopeAt(scene.single, region, x, y).slope, gradient.at(x, y), 2e-3);
      }
    }
  }
}

// The diagonal majoriser: a whole step of gradient / curvature_max from anywhere, rough or smooth, does not raise the energy. A
// checkerboard is the stiffest scene there is.
TEST(StructurePrior, AStepOfTheCurvatureBoundNeverRaisesTheEnergy) {
  const Roi region{0, 0, 14, 11};
  for (const StructurePriorKind kind : kKinds) {
    for (std::uint64_t seed = 0; seed < 20; ++seed) {
      Scene scene = RandomScene(seed, 0.5 * static_cast<double>(seed));
      if (seed == 0) {
        for (int y = 0; y < 11; ++y) {
          for (int x = 0; x < 14; ++x) scene.exact.at(x, y) = (x + y) % 2;
        }
        for (std::size_t i = 0; i < scene.exact.pixels().size(); ++i)
          scene.single.pixels()[i] = static_cast<float>(scene.exact.pixels()[i]);
      }
      const StructurePrior prior{kind, 4.0F};
      Image<float> gradient(14, 11);
      prior.AddGradient(scene.single, region, 1.0F, &gradient);
      const double before = Energy(prior, scene.exact, region);
      double decrease = 0.0;
      for (std::size_t i = 0; i < scene.exact.pixels().size(); ++i) {
        const double g = gradient.pixels()[i];
        scene.exact.pixels()[i] -= g / prior.curvature_max();
        decrease += 0.5 * g * g / prior.curvature_max();
      }
      EXPECT_LE(Energy(prior, scene.exact, region), before - decrease + 1e-4 * before)
          << "kind " << static_cast<int>(kind) << " seed " << seed;
    }
  }
}

TEST(StructurePrior, AStepOfOneCellNeverRaisesTheEnergy) {
  const Roi region{1, 0, 13, 11};
  for (const StructurePriorKind kind : kKinds) {
    const StructurePrior prior{kind, 2.0F};
    const Scene scene = RandomScene(7, 6.0);
    for (int y = region.y0; y < region.y1; ++y) {
      for (int x = region.x0; x < region.x1; ++x) {
        const CellSlope cell = prior.SlopeAt(scene.single, region, x, y);
        Image<double> moved = scene.exact;
        moved.at(x, y) -= cell.slope / cell.curvature;
        EXPECT_LE(Energy(prior, moved, region), Energy(prior, scene.exact, region) + 1e-3) << "kind " << static_cast<int>(kind);
      }
    }
  }
}

}  // namespace
}  // namespace trem
