// Goal: the vectorised evaluation of many views is the plain one, on every instruction set, byte for byte. Method: the samples against
// SampleCubic, the sums against loops in double precision, and each instruction set that this machine has against the others.
#include "worker/registration/pixel_terms.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <limits>

#include "hwy/targets.h"
#include "tests/unit/worker/registration/synthetic_scene.h"

namespace trem {
namespace {

using testing::Corners;
using testing::SyntheticScene;

// Huber's loss and moments of all pixels at `view` as the definitions say.
struct Plain {
  double cost = 0.0;
  PixelMoments moments;
};

Plain PlainSums(const SyntheticScene& scene, const Observation& observation, const View& view, double sigma) {
  Plain plain;
  for (int v = 0; v < scene.roi.height(); ++v) {
    for (int u = 0; u < scene.roi.width(); ++u) {
      const float intensity = observation.roi_pixels->at(u, v);
      const float weight = observation.weight(u, v);
      if (std::isnan(intensity) || !(weight > 0.0F)) continue;
      const Eigen::Vector2d cell = view.scene_from_sensor * Eigen::Vector2d(scene.roi.x0 + u, scene.roi.y0 + v) -
                                   Eigen::Vector2d(scene.x0, scene.y0);
      const bool supported = CubicSupported(scene.prediction, cell.x(), cell.y());
      const float n = supported ? scene.seen.at(static_cast<int>(cell.x() + 0.5), static_cast<int>(cell.y() + 0.5)) : 0.0F;
      if (n < 0.75F) {
        plain.cost += 13.5 * weight;
        plain.moments.missing += weight;
        continue;
      }
      const double s = weight * n / (n + 1.0);
      const double p = SampleCubic(scene.prediction, cell.x(), cell.y());
      const double r = intensity - view.gain * p - view.offset;
      const double z = std::abs(r) / sigma;
      plain.cost += s * (z <= 3.0 ? 0.5 * z * z : 3.0 * (z - 1.5));
      plain.moments.s += s;
      plain.moments.p += s * p;
      plain.moments.pp += s * p * p;
      plain.moments.r += s * r;
      plain.moments.rp += s * r * p;
      plain.moments.rr += s * r * r;
    }
  }
  return plain;
}

// A frame with all that can go wrong: unseen cells, NaN and weights, a view that leaves the scene.
struct Case {
  SyntheticScene scene{61};
  View view;
  Image<float> frame;
  Image<float> weights;

  Case() : view(scene.NominalMovedBy(Corners(0.413, -0.317, 0.722, 0.131, -0.193, 0.371), 1.02, -3.0)), frame(scene.Frame(view, 1)), weights(61, 61) {
    Rng rng({9});
    for (float& weight : weights.pixels()) weight = rng.Uniform() < 0.1 ? 0.0F : static_cast<float>(rng.Uniform());
    for (int k = 0; k < 40; ++k) frame.at(k, 20) = std::numeric_limits<float>::quiet_NaN();
    for (int x = 0; x < scene.seen.width(); ++x) {
      for (int y = 0; y < scene.seen.height(); ++y) scene.seen.at(x, y) = static_cast<float>((x / 7 + y / 5) % 4) / 2.0F;
    }
  }
  Observation observation() const {
    Observation o = scene.Observe(frame);
    o.weights = &weights;
    return o;
  }
};

TEST(PixelTerms, SumsAreThoseOfTheDefinition) {
  const Case c;
  PixelTerms terms(c.observation(), c.scene.reference(), 0, 0);
  for (const View& view : {c.view, c.scene.NominalMovedBy(Corners(30.21, 0.13, 30.21, 0.13, 30.21, 0.13), 0.9, 2.0)}) {
    const Plain plain = PlainSums(c.scene, c.observation(), view, 2.0);
    EXPECT_GT(plain.moments.missing, 0.0);
    terms.Sample(terms.All(), view);
    EXPECT_NEAR(terms.Cost(terms.All(), view.gain, view.offset, 2.0), plain.cost, 1e-4 * plain.cost);
    const PixelMoments m = terms.Moments(terms.All(), view.gain, view.offset);
    EXPECT_NEAR(m.s, plain.moments.s, 1e-5 * plain.moments.s);
    EXPECT_NEAR(m.p, plain.moments.p, 1e-5 * plain.moments.p);
    EXPECT_NEAR(m.pp, plain.moments.pp, 1e-5 * plain.moments.pp);
    EXPECT_NEAR(m.r, plain.moments.r, 1e-3 * std::sqrt(m.s * m.rr));
    EXPECT_NEAR(m.rp, plain.moments.rp, 1e-3 * std::sqrt(m.pp * m.rr));
    EXPECT_NEAR(m.rr, plain.moments.rr, 1e-4 * plain.moments.rr);
    EXPECT_NEAR(m.missing, plain.moments.missing, 1e-5 * plain.moments.missing);
  }
}

TEST(PixelTerms, EveryInstructionSetGivesTheSameBytes) {
  const Case c;
  PixelTerms terms(c.observation(), c.scene.reference(), 0, 0);
  struct Sums {
    double cost;
    PixelMoments moments;
  };
  std::vector<Sums> all;
  for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
    hwy::SetSupportedTargetsForTest(target);
    terms.Sample(terms.All(), c.view);
    all.push_back({terms.Cost(terms.All(), 1.0, 0.0, 2.0), terms.Moments(terms.All(), 1.0, 0.0)});
  }
  hwy::SetSupportedTargetsForTest(0);
  ASSERT_FALSE(all.empty());
  for (const Sums& sums : all) {
    EXPECT_EQ(sums.cost, all[0].cost);
    EXPECT_EQ(sums.moments.p, all[0].moments.p);
    EXPECT_EQ(sums.moments.pp, all[0].moments.pp);
    EXPECT_EQ(sums.moments.rp, all[0].moments.rp);
    EXPECT_EQ(sums.moments.rr, all[0].moments.rr);
    EXPECT_EQ(sums.moments.missing, all[0].moments.missing);
  }
}

TEST(PixelTerms, SubsetsSumUpToTheWhole) {
  const Case c;
  PixelTerms terms(c.observation(), c.scene.reference(), 0, 0);
  std::vector<int> even;
  std::vector<int> odd;
  for (int term = 0; term < terms.count(); ++term) (term % 2 == 0 ? even : odd).push_back(term);
  const PixelTerms::Range a = terms.Append(even);
  const PixelTerms::Range b = terms.Append(odd);
  double sum = 0.0;
  for (const PixelTerms::Range& part : {a, b}) {
    terms.Sample(part, c.view);
    sum += terms.Cost(part, 1.0, 0.0, 2.0);
  }
  terms.Sample(terms.All(), c.view);
  const double whole = terms.Cost(terms.All(), 1.0, 0.0, 2.0);
  EXPECT_NEAR(sum, whole, 1e-5 * whole);
}

// The integral over gain and offset by a dense grid.
TEST(FitGainOffset, TheMarginalIsTheIntegral) {
  const SyntheticScene scene(41);
  ViewPrior prior = scene.PriorAbout(scene.Nominal(), 2.0);
  prior.gain_sigma = 0.02;
  prior.offset_sigma = 1.5;
  const Image<float> frame = scene.Frame(scene.NominalMovedBy(CornerVector::Zero(6), 1.03, -3.0), 1);
  PixelTerms terms(scene.Observe(frame), scene.reference(), 0, 0);
  const auto integral = [&](const View& view, double sigma) {
    terms.Sample(terms.All(), view);
    const PixelMoments m = terms.Moments(terms.All(), 1.0, 0.0);
    const GainOffsetPosterior fit = FitGainOffset(m, prior, sigma);
    double sum = 0.0;
    const auto log_joint = [&](double g, double o) {
      const double rr = m.rr - 2.0 * (g * m.rp + o * m.r) + g * g * m.pp + 2.0 * g * o * m.p + o * o * m.s;
      return -0.5 * (rr / (sigma * sigma) + std::pow(g / prior.gain_sigma, 2) + std::pow(o / prior.offset_sigma, 2));
    };
    const double top = log_joint(fit.gain - 1.0, fit.offset);
    const double dg = std::sqrt(fit.covariance(0, 0)) / 8.0;
    const double spread = std::sqrt(fit.covariance(1, 1)) / 8.0;
    for (int i = -80; i <= 80; ++i) {
      for (int j = -80; j <= 80; ++j) sum += std::exp(log_joint(fit.gain - 1.0 + i * dg, fit.offset + j * spread) - top);
    }
    return std::pair(top + std::log(sum * dg * spread), fit.log_marginal);
  };
  const auto [a, marginal_a] = integral(scene.Nominal(), 40.0);
  const auto [b, marginal_b] = integral(scene.NominalMovedBy(Corners(3, 3, 3, 3, 3, 3)), 40.0);
  EXPECT_NEAR(a - b, marginal_a - marginal_b, 1e-6);
}

}  // namespace
}  // namespace trem
