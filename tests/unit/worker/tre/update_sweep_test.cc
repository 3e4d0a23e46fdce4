// Goal: a sweep is the information update's iteration, however the region is cut into tiles and whatever the processor's vectors.
// Method: tiles of all sizes against one tile, and AVX2 against AVX-512, byte for byte; the sweep against a plain double-precision
// iteration over whole images within rounding.
#include "worker/tre/update_sweep.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/support/simd_targets.h"
#include "tests/unit/worker/sensor/random_image.h"
#include "worker/sensor/blur.h"
#include "worker/sensor/reflect.h"

namespace trem {
namespace {

struct Case {
  int width = 0;
  int height = 0;
  Roi region;
  double sigma_px = 0.55;
  int ratio = 3;
};

const Case kCases[] = {
    {90, 70, {0, 0, 90, 70}},
    {90, 70, {13, 9, 71, 60}},          // Within the image.
    {90, 70, {0, 30, 24, 70}},          // In a corner.
    {47, 64, {44, 3, 47, 64}},          // Narrower than the PSF's radius.
    {5, 4, {0, 0, 5, 4}},               // The image is smaller than the PSF: reflected more than once.
    {40, 33, {1, 2, 39, 30}, 0.05, 1},  // The PSF is one cell.
    {80, 61, {7, 0, 80, 50}, 1.5, 3},   // A wide one.
};

struct State {
  Image<float> scene, previous, weight, weighted, majoriser, prediction;

  explicit State(const Case& c) {
    scene = RandomImage(c.width, c.height, 1);
    previous = RandomImage(c.width, c.height, 2);
    weight = RandomImage(c.width, c.height, 3);
    weighted = RandomImage(c.width, c.height, 4);
    majoriser = RandomImage(c.width, c.height, 5);
    prediction = Image<float>(c.width, c.height);
    for (float& s : scene.pixels()) s = 100.0F + 10.0F * s;
    for (float& s : previous.pixels()) s = 100.0F + 10.0F * s;
    for (std::size_t i = 0; i < weight.pixels().size(); ++i) {
      weight.pixels()[i] = std::abs(weight.pixels()[i]);
      weighted.pixels()[i] = weight.pixels()[i] * (100.0F + 10.0F * weighted.pixels()[i]);
      majoriser.pixels()[i] = 2.0F + std::abs(majoriser.pixels()[i]);
    }
    Blur(*MakePsf({c.sigma_px, 0.9}, c.ratio)).Apply(scene, &prediction);
  }
};

const StepWeights kWeights{0.3F, 4.0F, 2.4F};
const std::vector<float> kMomenta = {0.25F, 0.4F, 0.5F};

SeparablePsf Psf(const Case& c) { return *MakePsf({c.sigma_px, 0.9}, c.ratio); }

// The tiles must not read what another has written: results go to images of their own.
State Swept(const Case& c, std::size_t steps, int tile_width, int tile_height) {
  State state(c);
  State next = state;
  UpdateSweep sweep(Psf(c));
  const SweepPlanes planes{&state.scene,     &state.previous, &state.prediction, &state.weight,   &state.weighted,
                           &state.majoriser, &next.scene,     &next.previous,    &next.prediction};
  for (int y = c.region.y0; y < c.region.y1; y += tile_height) {
    for (int x = c.region.x0; x < c.region.x1; x += tile_width) {
      const Roi tile = Intersect(c.region, {x, y, x + tile_width, y + tile_height});
      sweep.Run(planes, c.region, tile, std::span(kMomenta).first(steps), kWeights);
    }
  }
  return next;
}

void ExpectSame(const State& a, const State& b, const std::string& what) {
  for (int y = 0; y < a.scene.height(); ++y) {
    for (int x = 0; x < a.scene.width(); ++x) {
      ASSERT_EQ(a.scene.at(x, y), b.scene.at(x, y)) << what << " scene at " << x << ", " << y;
      ASSERT_EQ(a.previous.at(x, y), b.previous.at(x, y)) << what << " previous at " << x << ", " << y;
      ASSERT_EQ(a.prediction.at(x, y), b.prediction.at(x, y)) << what << " prediction at " << x << ", " << y;
    }
  }
}

Image<double> Blurred(const Image<double>& image, const SeparablePsf& psf) {
  Image<double> out(image.width(), image.height());
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) {
      for (int j = -psf.radius(); j <= psf.radius(); ++j) {
        for (int i = -psf.radius(); i <= psf.radius(); ++i) {
          out.at(x, y) += static_cast<double>(psf.taps[static_cast<std::size_t>(std::abs(i))]) *
                          static_cast<double>(psf.taps[static_cast<std::size_t>(std::abs(j))]) *
                          image.at(ReflectIndex(x + i, image.width()), ReflectIndex(y + j, image.height()));
        }
      }
    }
  }
  return out;
}

Image<double> InDouble(const Image<float>& image) {
  Image<double> out(image.width(), image.height());
  for (std::size_t i = 0; i < image.pixels().size(); ++i) out.pixels()[i] = static_cast<double>(image.pixels()[i]);
  return out;
}

// One step over whole images as UpdateSweep's header writes it.
void PlainStep(const Case& c, const State& given, double momentum, Image<double>* scene, Image<double>* previous) {
  const Image<double> start = *scene;
  Image<double> residual = Blurred(start, Psf(c));
  for (std::size_t i = 0; i < residual.pixels().size(); ++i) {
    residual.pixels()[i] =
        static_cast<double>(given.weight.pixels()[i]) * residual.pixels()[i] - static_cast<double>(given.weighted.pixels()[i]);
  }
  const Image<double> gradient = Blurred(residual, Psf(c));
  const auto slope = [&](int x, int y, int dx, int dy) {
    if (!c.region.Contains(x + dx, y + dy)) return 0.0;
    return std::clamp(start.at(x, y) - start.at(x + dx, y + dy), -static_cast<double>(kWeights.limit), static_cast<double>(kWeights.limit));
  };
  for (int y = c.region.y0; y < c.region.y1; ++y) {
    for (int x = c.region.x0; x < c.region.x1; ++x) {
      const double prior = slope(x, y, -1, 0) + slope(x, y, 1, 0) + slope(x, y, 0, -1) + slope(x, y, 0, 1);
      const double next = start.at(x, y) - (gradient.at(x, y) + static_cast<double>(kWeights.lambda) * prior) /
                                               (static_cast<double>(given.majoriser.at(x, y)) + static_cast<double>(kWeights.damping));
      scene->at(x, y) = next + momentum * (next - previous->at(x, y));
      previous->at(x, y) = next;
    }
  }
}

TEST(UpdateSweep, EqualsAPlainIterationWithinRounding) {
  for (const Case& c : kCases) {
    const State given(c);
    Image<double> scene = InDouble(given.scene);
    Image<double> previous = InDouble(given.previous);
    for (std::size_t steps = 1; steps <= kMomenta.size(); ++steps) {
      PlainStep(c, given, static_cast<double>(kMomenta[steps - 1]), &scene, &previous);
      const Image<double> prediction = Blurred(scene, Psf(c));
      const State swept = Swept(c, steps, c.region.width(), c.region.height());
      for (int y = 0; y < c.height; ++y) {
        for (int x = 0; x < c.width; ++x) {
          ASSERT_NEAR(swept.scene.at(x, y), scene.at(x, y), 5e-4) << ToString(c.region) << " steps " << steps << " at " << x << ", " << y;
          ASSERT_NEAR(swept.previous.at(x, y), previous.at(x, y), c.region.Contains(x, y) ? 5e-4 : 0.0);
          // Beyond the region, too: the scene has changed within the radius.
          ASSERT_NEAR(swept.prediction.at(x, y), prediction.at(x, y), 5e-4) << ToString(c.region) << " at " << x << ", " << y;
        }
      }
    }
  }
}

TEST(UpdateSweep, TilesOfEverySizeGiveTheSameBytes) {
  for (const Case& c : kCases) {
    for (std::size_t steps = 1; steps <= kMomenta.size(); ++steps) {
      const State whole = Swept(c, steps, c.region.width(), c.region.height());
      for (const auto& [tile_width, tile_height] : {std::pair{1000, 11}, {17, 1000}, {32, 25}, {5, 7}}) {
        ExpectSame(whole, Swept(c, steps, tile_width, tile_height),
                   ToString(c.region) + " steps " + std::to_string(steps) + " tile width " + std::to_string(tile_width));
      }
    }
  }
}

TEST(UpdateSweep, InPlaceGivesTheSameBytes) {
  for (const Case& c : kCases) {
    for (std::size_t steps = 1; steps <= kMomenta.size(); ++steps) {
      State state(c);
      UpdateSweep sweep(Psf(c));
      const SweepPlanes planes{&state.scene,     &state.previous, &state.prediction, &state.weight,    &state.weighted,
                               &state.majoriser, &state.scene,    &state.previous,   &state.prediction};
      sweep.Run(planes, c.region, c.region, std::span(kMomenta).first(steps), kWeights);
      ExpectSame(state, Swept(c, steps, c.region.width(), c.region.height()), ToString(c.region));
    }
  }
}

TEST(UpdateSweep, EveryTargetWithFusedMultiplyAddGivesTheSameBytes) {
  const std::vector<std::int64_t> targets = testing::FusedTargets();
  if (targets.size() < 2) GTEST_SKIP() << "needs a processor with AVX2 and AVX-512";
  for (const Case& c : kCases) {
    std::vector<State> states;
    for (const std::int64_t target : targets) {
      const testing::WithTarget chosen(target);
      states.push_back(Swept(c, 3, 32, 25));
    }
    for (std::size_t i = 1; i < states.size(); ++i) ExpectSame(states[0], states[i], hwy::TargetName(targets[i]));
  }
}

}  // namespace
}  // namespace trem
