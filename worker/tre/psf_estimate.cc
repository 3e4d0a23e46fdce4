#include "worker/tre/psf_estimate.h"

#include <ceres/ceres.h>
#include <fmt/format.h>

#include <array>
#include <cmath>
#include <map>
#include <numbers>
#include <utility>
#include <vector>

namespace trem {
namespace {

// Lower frequencies are few, and what the window leaks there is not small beside the fall-off.
constexpr double kFrequencyMin = 0.04;
// Aliases of up to so many times the sampling frequency; beyond, detector and optics leave nothing.
constexpr int kAliases = 2;
constexpr double kExponent = 2.05;
constexpr double kExponentSpread = 0.25;
// A spectrum's deviations from the model are broad: residuals count as so many independent ones.
constexpr double kIndependentResiduals = 25.0;
// Log power. Statistical fluctuations are below when there are tiles enough.
constexpr double kMisfitMin = 0.05;
constexpr double kMisfitMax = 0.26;
constexpr double kLossScale = 3.0;  // In units of the misfit.
constexpr int kTilesMin = 40;
constexpr double kSigmaMin_px = 0.15;
constexpr double kSigmaMax_px = 1.6;
constexpr double kErrorFloor_px = 0.075;
constexpr double kErrorMax_px = 0.14;
// The noise is reported when its log variance is known as well as this.
constexpr double kNoiseErrorMax = 0.2;

enum Parameter { kLogAmplitude, kScene, kSigma, kLogNoise, kCos2, kSin2, kCos4, kSin4, kParameterCount };
using Parameters = std::array<double, kParameterCount>;

double Sinc(double x) { return std::abs(x) < 1e-9 ? 1.0 : std::sin(std::numbers::pi * x) / (std::numbers::pi * x); }

// (log model - log power) * weight. What does not depend on the parameters is computed once: fits ask for thousands of bins again and
// again.
class LogPowerResidual {
 public:
  LogPowerResidual(const FrameSpectrum::Bin& bin, double fill_factor, double weight) : log_power_(std::log(bin.power)), weight_(weight) {
    Alias* alias = aliases_.data();
    for (int k = -kAliases; k <= kAliases; ++k) {
      for (int l = -kAliases; l <= kAliases; ++l) {
        const double fx = bin.fx + k;
        const double fy = bin.fy + l;
        const double squared = fx * fx + fy * fy;
        const double angle = std::atan2(fy, fx);
        alias->box = std::pow(Sinc(fill_factor * fx) * Sinc(fill_factor * fy), 2);
        alias->log_frequency = 0.5 * std::log(squared);
        alias->optics = 4.0 * std::numbers::pi * std::numbers::pi * squared;
        alias->cos2 = std::cos(2.0 * angle);
        alias->sin2 = std::sin(2.0 * angle);
        alias->cos4 = std::cos(4.0 * angle);
        alias->sin4 = std::sin(4.0 * angle);
        ++alias;
      }
    }
  }

  template <typename T>
  bool operator()(const T* p, T* residual) const {
    using std::exp;
    using std::log;
    T power = exp(p[kLogNoise]);
    for (const Alias& alias : aliases_) {
      power += alias.box * exp(p[kLogAmplitude] - alias.log_frequency * p[kScene] - alias.optics * p[kSigma] * p[kSigma] +
                               alias.cos2 * p[kCos2] + alias.sin2 * p[kSin2] + alias.cos4 * p[kCos4] + alias.sin4 * p[kSin4]);
    }
    residual[0] = (log(power) - log_power_) * weight_;
    return true;
  }

 private:
  struct Alias {
    double box, log_frequency, optics, cos2, sin2, cos4, sin4;
  };
  static constexpr int kSide = 2 * kAliases + 1;

  std::array<Alias, kSide * kSide> aliases_;
  double log_power_;
  double weight_;
};

struct ExponentPrior {
  template <typename T>
  bool operator()(const T* p, T* residual) const {
    residual[0] = (p[kScene] - kExponent) / kExponentSpread;
    return true;
  }
};

// Rings have bins in proportion to their frequency; each ring counts alike.
double RingWeight(const FrameSpectrum::Bin& bin) { return 1.0 / std::sqrt(std::hypot(bin.fx, bin.fy)); }

struct Fit {
  bool converged = false;
  double misfit = 0.0;
  double sigma_error_px = 0.0;
  double log_noise_error = 0.0;
};

// Rms over polar cells of the mean deviation of the log power from the model. Single bins fluctuate, whatever the ground.
double Misfit(const std::vector<FrameSpectrum::Bin>& bins, double fill_factor, const Parameters& p) {
  constexpr double kRing = 0.05;
  constexpr int kSectors = 8;
  struct Cell {
    double sum = 0.0;
    int count = 0;
  };
  std::map<std::pair<int, int>, Cell> cells;
  for (const FrameSpectrum::Bin& bin : bins) {
    double residual = 0.0;
    LogPowerResidual(bin, fill_factor, 1.0)(p.data(), &residual);
    const auto ring = static_cast<int>(std::hypot(bin.fx, bin.fy) / kRing);
    const auto sector = static_cast<int>(std::atan2(bin.fy, bin.fx) / std::numbers::pi * kSectors);
    Cell& cell = cells[{ring, sector}];
    cell.sum += residual;
    ++cell.count;
  }
  double sum = 0.0;
  for (const auto& [place, cell] : cells) sum += std::pow(cell.sum / cell.count, 2);
  return std::sqrt(sum / static_cast<double>(cells.size()));
}

// Fits `p`, which holds the start. `misfit`: the expected rms of the log power about the model.
Fit FitModel(const std::vector<FrameSpectrum::Bin>& bins, double fill_factor, double misfit, Parameters* p) {
  double weight_sum = 0.0;
  for (const FrameSpectrum::Bin& bin : bins) weight_sum += std::pow(RingWeight(bin), 2);
  const double scale = std::sqrt(kIndependentResiduals / weight_sum) / misfit;
  ceres::Problem problem;
  for (const FrameSpectrum::Bin& bin : bins) {
    const double weight = scale * RingWeight(bin);
    auto* loss = new ceres::SoftLOneLoss(kLossScale * misfit * weight);
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<LogPowerResidual, 1, kParameterCount>(new LogPowerResidual(bin, fill_factor, weight)), loss,
        p->data());
  }
  problem.AddResidualBlock(new ceres::AutoDiffCostFunction<ExponentPrior, 1, kParameterCount>(new ExponentPrior), nullptr, p->data());
  problem.SetParameterLowerBound(p->data(), kSigma, 0.01);
  problem.SetParameterUpperBound(p->data(), kSigma, 3.0);
  problem.SetParameterLowerBound(p->data(), kLogNoise, -12.0);
  problem.SetParameterUpperBound(p->data(), kLogNoise, 12.0);
  ceres::Solver::Options options;
  options.max_num_iterations = 100;
  options.num_threads = 1;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  Fit fit;
  fit.converged = summary.IsSolutionUsable();
  fit.misfit = Misfit(bins, fill_factor, *p);
  ceres::Covariance::Options covariance_options;
  covariance_options.algorithm_type = ceres::DENSE_SVD;
  covariance_options.null_space_rank = -1;
  ceres::Covariance covariance(covariance_options);
  Eigen::Matrix<double, kParameterCount, kParameterCount, Eigen::RowMajor> matrix;
  if (fit.converged && covariance.Compute(std::vector<const double*>{p->data()}, &problem) &&
      covariance.GetCovarianceBlock(p->data(), p->data(), matrix.data())) {
    fit.sigma_error_px = std::sqrt(matrix(kSigma, kSigma));
    fit.log_noise_error = std::sqrt(matrix(kLogNoise, kLogNoise));
  } else {
    fit.converged = false;
  }
  return fit;
}

double Rounded(double x) { return std::round(1000.0 * x) / 1000.0; }

}  // namespace

PsfEstimate EstimatePsfSigma(const FrameSpectrum& spectrum, double fill_factor) {
  PsfEstimate estimate;
  if (spectrum.tile_count() < kTilesMin) {
    estimate.doubt = fmt::format("there are too few frames or too small ones: {} tiles of {} x {} px, {} are needed", spectrum.tile_count(),
                                 FrameSpectrum::kSide, FrameSpectrum::kSide, kTilesMin);
    return estimate;
  }
  const std::vector<FrameSpectrum::Bin> bins = spectrum.Bins(kFrequencyMin);
  double least = bins.empty() ? 0.0 : bins.front().power;
  double most = least;
  for (const FrameSpectrum::Bin& bin : bins) {
    least = std::min(least, bin.power);
    most = std::max(most, bin.power);
  }
  if (bins.empty() || most < 4.0 * least) {
    estimate.doubt = "the frames show noise and no texture";
    return estimate;
  }
  Parameters p{};
  p[kLogAmplitude] = std::log(most) + kExponent * std::log(kFrequencyMin);
  p[kScene] = kExponent;
  p[kSigma] = 0.5;
  p[kLogNoise] = std::log(least);
  Fit fit = FitModel(bins, fill_factor, 2.0 * kMisfitMin, &p);
  if (fit.converged) fit = FitModel(bins, fill_factor, std::max(fit.misfit, kMisfitMin), &p);
  if (!fit.converged) {
    estimate.doubt = "no model fits the frames' spectrum";
    return estimate;
  }
  estimate.sigma_px = Rounded(p[kSigma]);
  estimate.error_px = Rounded(std::hypot(fit.sigma_error_px, kErrorFloor_px));
  estimate.scene_exponent = Rounded(p[kScene]);
  estimate.misfit = Rounded(fit.misfit);
  // A floor far below everything that is there is no measurement.
  if (fit.log_noise_error < kNoiseErrorMax && std::exp(p[kLogNoise]) > 0.1 * least)
    estimate.noise_sigma = Rounded(std::exp(0.5 * p[kLogNoise]));
  if (fit.misfit > kMisfitMax) {
    estimate.doubt = fmt::format(
        "the frames' spectrum is not that of open ground under a Gaussian blur: it deviates by {:.2f} in the logarithm", fit.misfit);
  } else if (estimate.sigma_px < kSigmaMin_px || estimate.sigma_px > kSigmaMax_px) {
    estimate.doubt = fmt::format("{:.2f} px is no width of a sensor's", estimate.sigma_px);
  } else if (estimate.error_px > kErrorMax_px) {
    estimate.doubt = fmt::format("noise hides the fall-off: the error would be {:.2f} px", estimate.error_px);
  }
  return estimate;
}

}  // namespace trem
