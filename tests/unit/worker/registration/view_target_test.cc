// Goal: integrating gain and offset out gives the marginal of the joint posterior, and the profile likelihood is something else. Method: a
// scene whose contrast grows along x, so that a shift and a gain can hardly be told apart, and noise within Huber's corner, so that the
// joint model is Gaussian; moments of long chains are compared by batch means (50 batches; 5 standard errors of the difference have a false
// alarm rate of about 1e-5, and the seeds are fixed).
#include "worker/registration/view_target.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <vector>

#include "mosaic/base/rng.h"
#include "tests/unit/worker/registration/synthetic_scene.h"

namespace trem {
namespace {

constexpr int kRoiPx = 31;
constexpr double kSigma = 20.0;
constexpr double kGainPerPx = 0.15;  // The contrast grows by this part a sensor pixel.

struct Confounded {
  testing::SyntheticScene scene{kRoiPx};
  Image<float> frame{kRoiPx, kRoiPx};
  ViewPrior prior;

  Confounded() {
    const int middle = scene.prediction.width() / 2;
    for (int y = 0; y < scene.prediction.height(); ++y) {
      for (int x = 0; x < scene.prediction.width(); ++x) {
        scene.prediction.at(x, y) = static_cast<float>(40.0 * std::exp(kGainPerPx / 3.0 * (x - middle)) * std::sin(0.7 * y));
      }
    }
    const double noise = scene.noise_sigma;
    scene.noise_sigma = 0.0;
    frame = scene.Frame(scene.Nominal(), 1);
    scene.noise_sigma = noise;
    Rng rng({4});
    for (float& pixel : frame.pixels()) pixel += static_cast<float>(kSigma * (2.0 * rng.Uniform() - 1.0));
    prior = scene.PriorAbout(scene.Nominal(), 3.0);
    prior.gain_sigma = 0.2;
    prior.offset_sigma = 5.0;
  }
};

// Mean and variance of the shift along x, with their standard errors.
struct Moments {
  double value[2];
  double error[2];
};

Moments MomentsOf(const std::vector<HintsState>& draws) {
  constexpr std::size_t kBatches = 50;
  double centre = 0.0;
  for (const HintsState& draw : draws) centre += draw(0) / static_cast<double>(draws.size());
  Moments m{};
  for (int power = 0; power < 2; ++power) {
    std::vector<double> batches(kBatches);
    for (std::size_t i = 0; i < draws.size(); ++i) {
      const double x = draws[i](0);
      batches[i * kBatches / draws.size()] += (power == 0 ? x : (x - centre) * (x - centre)) * kBatches / static_cast<double>(draws.size());
    }
    double squares = 0.0;
    for (const double batch : batches) m.value[power] += batch / kBatches;
    for (const double batch : batches) squares += std::pow(batch - m.value[power], 2) / (kBatches - 1);
    m.error[power] = std::sqrt(squares / kBatches);
  }
  return m;
}

Moments ShiftUnder(const Confounded& toy, Photometry photometry) {
  PixelTerms terms(toy.scene.Observe(toy.frame), toy.scene.reference(), 0, 0);
  ViewChart chart = FullChart(toy.prior, toy.scene.roi);
  HintsMatrix along_x(6, 1);
  along_x << 1, 0, 1, 0, 1, 0;
  chart.basis = along_x;
  const ViewTarget target(&terms, toy.prior, chart, photometry, kSigma);
  HintsMatrix shape = HintsMatrix::Identity(target.dimension(), target.dimension());
  if (photometry == Photometry::kJoint) {
    shape << 1.2, 0, 0, -1.2 * kGainPerPx, 0.03, 0, 0, 0, 1.0;
  }
  HintsOptions options;
  options.levels = 0;
  options.sweeps = 40000;
  options.burn_in = 500;
  options.keep_draws = true;
  options.seed_key = {1, 2, 3};
  return MomentsOf(RunHints(target, HintsState::Zero(target.dimension()), shape, options).value().draws);
}

double StandardErrorsApart(const Moments& a, const Moments& b, int power) {
  return std::abs(a.value[power] - b.value[power]) / std::hypot(a.error[power], b.error[power]);
}

TEST(ViewTarget, TheMarginalOfTheJointChainIsTheMarginalisedChainAndNotTheProfiledOne) {
  const Confounded toy;
  const Moments joint = ShiftUnder(toy, Photometry::kJoint);
  const Moments marginalised = ShiftUnder(toy, Photometry::kMarginalised);
  const Moments profiled = ShiftUnder(toy, Photometry::kProfiled);
  EXPECT_LT(StandardErrorsApart(joint, marginalised, 0), 5.0) << joint.value[0] << " against " << marginalised.value[0];
  EXPECT_LT(StandardErrorsApart(joint, marginalised, 1), 5.0) << joint.value[1] << " against " << marginalised.value[1];
  EXPECT_GT(StandardErrorsApart(marginalised, profiled, 0), 5.0) << marginalised.value[0] << " against " << profiled.value[0];
}

}  // namespace
}  // namespace trem
