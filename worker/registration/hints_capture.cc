#include "worker/registration/hints_capture.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <vector>

#include "worker/registration/hints.h"
#include "worker/registration/pixel_terms.h"
#include "worker/registration/view_chart.h"
#include "worker/registration/view_target.h"

namespace trem {
namespace {

// Reach of the scan: displacement of the ROI's centre [px], for a ROI of 151 px in proportion, and rotation.
constexpr double kReachOfSide = 30.0 / 151.0;
constexpr double kReachRad = 18.0 * 3.14159265358979323846 / 180.0;
// Steps of the scan, pixels of its level: of a translation, and of a corner's motion under rotation.
constexpr double kScanStep = 0.75;
constexpr int kScanPixelsMin = 150;
constexpr int kReductionsMax = 6;
constexpr std::size_t kChains = 6;
constexpr int kChainSweeps = 10;
constexpr int kLastSweeps = 16;
// Reduced images' residuals are misregistration and aliasing much more than noise.
constexpr double kSigmaFactor = 3.0;

struct Place {
  HintsState x;  // Translation x, y, rotation, scale: SimilarityChart.
  double log_density = 0.0;
};

// The coarsest level that still has enough pixels; 0 for a ROI that has not.
int ScanReductions(const Roi& roi) {
  int reductions = 0;
  while (reductions < kReductionsMax && (roi.width() >> (reductions + 1)) * (roi.height() >> (reductions + 1)) >= kScanPixelsMin) ++reductions;
  return reductions;
}

std::vector<Place> Scan(const ViewTarget& target, const PixelTerms::Range& all, const Roi& roi, double step_px) {
  const double side = std::sqrt(static_cast<double>(roi.width()) * roi.height());
  const double radius = 0.5 * std::hypot(roi.width(), roi.height());
  const int shifts = static_cast<int>(std::ceil(kReachOfSide * side / step_px));
  const int turns = static_cast<int>(std::ceil(kReachRad * radius / step_px));
  std::vector<Place> places;
  places.reserve(static_cast<std::size_t>((2 * shifts + 1) * (2 * shifts + 1) * (2 * turns + 1)));
  for (int turn = -turns; turn <= turns; ++turn) {
    const double angle = turn * step_px / radius;
    for (int y = -shifts; y <= shifts; ++y) {
      for (int x = -shifts; x <= shifts; ++x) {
        // I + basis * x is a turn without change of scale when the rotation is the sine and the scale the cosine less 1.
        HintsState state(4);
        state << x * step_px, y * step_px, radius * std::sin(angle), radius * (std::cos(angle) - 1.0);
        const double log = target.LogPixels(all, state) + target.LogPrior(state);
        places.push_back({state, log});
      }
    }
  }
  return places;
}

// The best places, none within two steps of a better one.
std::vector<Place> BestApart(std::vector<Place> places, double step_px) {
  std::stable_sort(places.begin(), places.end(), [](const Place& a, const Place& b) { return a.log_density > b.log_density; });
  std::vector<Place> chosen;
  for (const Place& place : places) {
    const bool apart = std::all_of(chosen.begin(), chosen.end(), [&](const Place& better) {
      return (place.x - better.x).head<3>().cwiseAbs().maxCoeff() > 1.5 * step_px;
    });
    if (apart) chosen.push_back(place);
    if (chosen.size() == kChains) break;
  }
  return chosen;
}

// Proposals over all corner displacements: a common translation, and each corner a third of it.
HintsMatrix CaptureShape(Eigen::Index dimension, double step_px) {
  HintsMatrix covariance = HintsMatrix::Identity(dimension, dimension) / 9.0;
  for (Eigen::Index a = 0; a < dimension; ++a) {
    for (Eigen::Index b = a % 2; b < dimension; b += 2) covariance(a, b) += 1.0;
  }
  return step_px * HintsMatrix(covariance.llt().matrixL());
}

// HINTS from `start` on `terms`; `start` itself when its density is not finite.
Place Chain(const Observation& observation, const ViewPrior& prior, const HintsState& start, int sweeps, double step_px,
            const std::array<std::uint64_t, 3>& key, PixelTerms* terms, std::int64_t* pixel_evaluations) {
  const ViewTarget target(terms, prior, FullChart(prior, observation.roi), Photometry::kProfiled, kSigmaFactor * observation.noise_sigma);
  HintsOptions options;
  options.seed_key = key;
  options.leaf_size = 24;
  options.levels = 2;
  options.burn_in = sweeps - 1;
  options.sweeps = 1;
  options.step = 0.5;
  const Result<HintsResult> run = RunHints(target, start, CaptureShape(start.size(), step_px), options);
  if (!run.ok()) return {start, -1e300};
  *pixel_evaluations += run->term_evaluations;
  return {run->best, run->best_log_density};
}

}  // namespace

Registration CaptureByHints(const Observation& observation, const Reference& reference, const ViewPrior& prior,
                            const std::uint64_t (&stream)[3], std::int64_t* pixel_evaluations) {
  std::int64_t evaluations = 0;
  const Roi& roi = observation.roi;
  const int reductions = ScanReductions(roi);
  const double step_px = kScanStep * (1 << reductions);
  const ViewChart similarity = SimilarityChart(prior, roi);
  PixelTerms coarse(observation, reference, reductions, 0);
  if (coarse.count() < 16) return EvaluateView(observation, reference, prior, prior.mean);
  const ViewTarget scanned(&coarse, prior, similarity, Photometry::kProfiled, kSigmaFactor * observation.noise_sigma);
  const std::vector<Place> places = Scan(scanned, coarse.All(), roi, step_px);
  evaluations += static_cast<std::int64_t>(places.size()) * coarse.count();

  PixelTerms middle(observation, reference, std::max(reductions - 1, 0), 0);
  Place best{HintsState::Zero(prior.information.rows()), -1e300};
  std::uint64_t part = 1;
  const auto key = [&](std::uint64_t chain) { return std::array<std::uint64_t, 3>{stream[0], stream[1], stream[2] ^ (chain << 48)}; };
  for (const Place& place : BestApart(places, step_px)) {
    const HintsState start = similarity.basis * place.x;
    const Place end = Chain(observation, prior, start, kChainSweeps, 0.5 * step_px, key(part++), &middle, &evaluations);
    if (end.log_density > best.log_density) best = end;
  }
  PixelTerms last(observation, reference, std::max(reductions - 2, 0), 1024);
  best = Chain(observation, prior, best.x, kLastSweeps, 0.2 * step_px, key(part), &last, &evaluations);
  const ViewTarget target(&last, prior, FullChart(prior, roi), Photometry::kProfiled, kSigmaFactor * observation.noise_sigma);
  Registration registration = EvaluateView(observation, reference, prior, target.ViewAt(best.x));
  registration.converged = registration.overlap > 0.0;
  if (pixel_evaluations != nullptr) *pixel_evaluations += evaluations;
  return registration;
}

}  // namespace trem
