// Goal: AddGradient is the gradient of the energy that the header states, within its region. Method: finite differences of the energy,
// computed here in double precision.
#include "worker/tre/structure_prior.h"

#include <gtest/gtest.h>

#include <cmath>

#include "mosaic/base/rng.h"

namespace trem {
namespace {

double Psi(StructurePriorKind kind, double delta, double d) {
  const double size = std::abs(d);
  return kind == StructurePriorKind::kMembrane || size <= delta ? 0.5 * d * d : delta * (size - 0.5 * delta);
}

double Energy(const StructurePrior& prior, const Image<double>& scene, const Roi& region) {
  double sum = 0.0;
  for (int y = region.y0; y < region.y1; ++y) {
    for (int x = region.x0; x < region.x1; ++x) {
      if (x + 1 < region.x1) sum += Psi(prior.kind, prior.delta, scene.at(x + 1, y) - scene.at(x, y));
      if (y + 1 < region.y1) sum += Psi(prior.kind, prior.delta, scene.at(x, y + 1) - scene.at(x, y));
    }
  }
  return sum;
}

TEST(StructurePrior, TheGradientIsThatOfTheEnergy) {
  constexpr float kWeight = 0.7F;
  Rng rng({1});
  Image<float> scene(14, 11);
  Image<double> exact(14, 11);
  for (std::size_t i = 0; i < scene.pixels().size(); ++i) {
    scene.pixels()[i] = static_cast<float>(100.0 + 5.0 * rng.Normal());
    exact.pixels()[i] = scene.pixels()[i];
  }
  for (const StructurePriorKind kind : {StructurePriorKind::kHuberTv, StructurePriorKind::kMembrane}) {
    for (const Roi& region : {Roi{0, 0, 14, 11}, Roi{3, 2, 10, 9}, Roi{5, 5, 6, 9}, Roi{5, 5, 9, 6}, Roi{4, 4, 5, 5}}) {
      const StructurePrior prior{kind, 4.0F};
      Image<float> gradient(14, 11, 1.0F);
      prior.AddGradient(scene, region, kWeight, &gradient);
      for (int y = 0; y < 11; ++y) {
        for (int x = 0; x < 14; ++x) {
          constexpr double kStep = 1e-4;
          Image<double> moved = exact;
          moved.at(x, y) += kStep;
          const double above = Energy(prior, moved, region);
          moved.at(x, y) -= 2.0 * kStep;
          const double slope = (above - Energy(prior, moved, region)) / (2.0 * kStep);
          ASSERT_NEAR(gradient.at(x, y), 1.0 + kWeight * slope, 2e-3) << x << ", " << y << " of " << ToString(region);
        }
      }
    }
  }
}

}  // namespace
}  // namespace trem
