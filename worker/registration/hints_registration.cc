#include "worker/registration/hints_registration.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <optional>

#include "worker/registration/hints.h"
#include "worker/registration/hints_capture.h"
#include "worker/registration/pixel_terms.h"
#include "worker/registration/view_target.h"

namespace trem {
namespace {

// Proposals of the travel start with this size [sensor px] at full resolution.
constexpr double kTravelStepPx = 0.05;
constexpr int kLegsMax = 3;
// Least side of a reduced frame [px].
constexpr int kReducedSideMin = 18;
// Proposals are this much wider than Laplace's approximation: tails lighter than the target's would make the chain stick.
constexpr double kProposalWidth = 1.1;

std::array<std::uint64_t, 3> KeyOf(const std::uint64_t (&stream)[3], std::uint64_t part) {
  return {stream[0], stream[1], stream[2] ^ (part << 48)};
}

// The lower factor of `covariance` [px^2 of displacement] in the chart's coordinates; nothing when it has none.
std::optional<HintsMatrix> CovarianceInChart(const CornerMatrix& covariance, const ViewChart& chart) {
  const HintsMatrix information = HintsMatrix(covariance).inverse();
  const HintsMatrix in_chart = (chart.basis.transpose() * information * chart.basis).inverse();
  if (!in_chart.allFinite() || Eigen::LLT<HintsMatrix>(in_chart).info() != Eigen::Success) return {};
  return in_chart;
}

// From the chart's origin to the neighbourhood of the optimum.
HintsState Travel(const Observation& observation, const Reference& reference, const ViewPrior& prior, const ViewChart& chart,
                  const HintsSettings& settings, const std::uint64_t (&stream)[3], HintsCost* cost) {
  HintsState state = HintsState::Zero(chart.dimension());
  const int side = std::min(observation.roi.width(), observation.roi.height());
  for (int reductions = kLegsMax - 1; reductions >= 0; --reductions) {
    if (settings.travel_sweeps == 0 || (reductions > 0 && (side >> reductions) < kReducedSideMin)) continue;
    PixelTerms terms(observation, reference, reductions, settings.travel_terms);
    const double sigma = (reductions > 0 ? 3.0 : 1.0) * observation.noise_sigma;
    const ViewTarget target(&terms, prior, chart, Photometry::kProfiled, sigma);
    HintsOptions options;
    options.seed_key = KeyOf(stream, static_cast<std::uint64_t>(reductions) + 1);
    options.leaf_size = 24;
    options.burn_in = settings.travel_sweeps - 1;
    options.sweeps = 1;
    options.step = 1.0;
    if (terms.count() < options.leaf_size) continue;
    // One isotropic step suits displacements of corners; its length adapts.
    const HintsMatrix shape = HintsMatrix::Identity(chart.dimension(), chart.dimension()) * (kTravelStepPx * (1 << reductions));
    const Result<HintsResult> leg = RunHints(target, state, shape, options);
    if (!leg.ok()) continue;
    state = leg->best;
    cost->pixel_evaluations += leg->term_evaluations;
  }
  return state;
}

// What the chart's coordinates of `view` are, when it is off the chart's subspace: nearest under `information`.
HintsState CoordinatesOf(const View& view, const ViewChart& chart, const CornerMatrix& information) {
  const HintsState d = CornerDisplacement(chart.centre.scene_from_sensor, view.scene_from_sensor, chart.roi, ModelOf(chart.basis.rows()));
  const HintsMatrix weighted = chart.basis.transpose() * HintsMatrix(information);
  return HintsMatrix(weighted * chart.basis).inverse() * (weighted * d);
}

// The covariance that is reported, of `n` effective draws of which `sample` is the covariance and `shape` what was expected.
HintsMatrix ReportedCovariance(const HintsMatrix& sample, const HintsMatrix& expected, double n) {
  const double d = static_cast<double>(sample.rows());
  const double prior_draws = d + 2.0;
  const double draws = prior_draws + n - 1.0;
  const HintsMatrix mixed = (prior_draws * expected + (n - 1.0) * sample) / draws;
  return mixed * (draws / (draws - d - 1.0)) * (1.0 + 1.0 / n);
}

}  // namespace

Registration RegisterHints(const Observation& observation, const Reference& reference, const ViewPrior& prior, HintsUse use,
                           const std::uint64_t (&stream)[3], const HintsSettings& settings, HintsCost* cost) {
  HintsCost ignored;
  if (cost == nullptr) cost = &ignored;
  *cost = {};
  if (use == HintsUse::kCapture) return CaptureByHints(observation, reference, prior, stream, &cost->pixel_evaluations);
  const ViewChart chart = settings.chart != nullptr ? *settings.chart : FullChart(prior, observation.roi);
  const HintsState arrived = Travel(observation, reference, prior, chart, settings, stream, cost);

  GaussNewtonOptions one_step;
  one_step.iterations_max = 1;
  PixelTerms terms(observation, reference, 0, 0);
  const bool joint = settings.gain_offset == GainOffset::kMaximumLikelihood;
  const ViewTarget profiled(&terms, prior, chart, Photometry::kProfiled, observation.noise_sigma);
  const Registration centre = RegisterGaussNewton(observation, reference, prior, profiled.ViewAt(arrived), one_step);
  const std::optional<HintsMatrix> covariance = CovarianceInChart(centre.corner_covariance, chart);
  if (!(centre.overlap > 0.0) || !covariance) return centre;
  // As in Laplace's approximation: the residuals, not the nominal noise, say how well this frame determines its view.
  const double sigma = std::max(observation.noise_sigma, centre.residual_rms);
  const ViewTarget target(&terms, prior, chart, joint ? Photometry::kJoint : Photometry::kMarginalised, sigma);
  const int d = chart.dimension();
  HintsOptions options;
  options.seed_key = KeyOf(stream, 0);
  options.levels = 0;
  options.burn_in = 4;
  options.sweeps = settings.draws;
  options.centre = HintsState::Zero(target.dimension());
  options.centre.head(d) = CoordinatesOf(centre.view, chart, HintsMatrix(centre.corner_covariance).inverse());
  HintsMatrix spread = HintsMatrix::Zero(target.dimension(), target.dimension());
  spread.topLeftCorner(d, d) = *covariance;
  if (joint) {
    options.centre.tail<2>() << centre.view.gain - prior.mean.gain, centre.view.offset - prior.mean.offset;
    spread.bottomRightCorner<2, 2>() = centre.gain_offset_covariance;
  }
  terms.Sample(terms.All(), centre.view);
  terms.FreezeRobustFactors(centre.view.gain, centre.view.offset, sigma);
  const HintsMatrix shape = kProposalWidth * HintsMatrix(spread.llt().matrixL());
  const Result<HintsResult> draws = RunHints(target, options.centre, shape, options);
  if (!draws.ok()) return centre;
  cost->pixel_evaluations += draws->term_evaluations;
  cost->acceptance = draws->acceptance_rates.front();
  cost->effective_draws = draws->effective_draws;
  Registration registration = EvaluateView(observation, reference, prior, target.ViewAt(draws->mean));
  registration.converged = registration.overlap > 0.0;
  const HintsMatrix reported = ReportedCovariance(draws->covariance.topLeftCorner(d, d), *covariance, draws->effective_draws);
  registration.corner_covariance = chart.basis * reported * chart.basis.transpose();
  return registration;
}

}  // namespace trem
