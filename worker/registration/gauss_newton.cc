#include "worker/registration/gauss_newton.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <vector>

#include "worker/registration/reduce.h"
#include "worker/sensor/bicubic.h"

namespace trem {
namespace {

// Corner displacements, gain, offset: 8 or 10 parameters.
using Parameters = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, 10, 1>;
using ParameterMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 10, 10>;

// Least part of the ROI's pixels that must have seen scene behind them for a step to mean anything.
constexpr double kOverlapMin = 0.05;

// One resolution level: reduced frame and reference, and how their grids lie in the full ones.
struct Level {
  const Image<float>* frame = nullptr;
  const Image<float>* prediction = nullptr;
  const Image<float>* seen = nullptr;
  double frame_step = 1.0;      // Full-resolution sensor pixels per level pixel.
  double reference_step = 1.0;  // Full-resolution cells per level cell.
  int pixel_stride = 1;         // Uses every n-th pixel of every n-th row.
};

// Gauss-Newton's normal equations at one view, with what validation needs.
struct Normal {
  explicit Normal(Eigen::Index parameters) : a(ParameterMatrix::Zero(parameters, parameters)), b(Parameters::Zero(parameters)) {}
  ParameterMatrix a;
  Parameters b;
  double weight = 0.0;        // Sum of seen weights.
  double robust_weight = 0.0;
  double cost = 0.0;          // Mean Huber cost per unit seen weight, in sigma^2.
  double sum_w_r2 = 0.0;
  double sum_i = 0.0;
  double sum_i2 = 0.0;
  long long pixels = 0;
  long long candidates = 0;
};

// Maps pixel k of a reduced grid to full-resolution coordinates: the centre of the block it averages.
double FullFromLevel(double k, double step) { return k * step + 0.5 * (step - 1.0); }
double LevelFromFull(double x, double step) { return (x - 0.5 * (step - 1.0)) / step; }

// `residuals`, when given, receives |r| of every used pixel.
Normal Accumulate(const Observation& observation, const Reference& reference, const Level& level, const View& view, double sigma,
                  double huber_sigmas, ViewModel model, std::vector<float>* residuals) {
  const Eigen::Index corners = ParameterCount(model);
  Normal normal(corners + 2);
  const Roi& roi = observation.roi;
  const double inverse_sigma2 = 1.0 / (sigma * sigma);
  const double huber = huber_sigmas * sigma;
  const bool affine = view.scene_from_sensor.IsAffine();
  Eigen::Matrix2d m = view.scene_from_sensor.linear;
  Parameters j(corners + 2);
  for (int v = level.pixel_stride / 2; v < level.frame->height(); v += level.pixel_stride) {
    const float* frame_row = level.frame->row(v);
    ParameterMatrix row_a = ParameterMatrix::Zero(corners + 2, corners + 2);
    Parameters row_b = Parameters::Zero(corners + 2);
    for (int u = level.pixel_stride / 2; u < level.frame->width(); u += level.pixel_stride) {
      const float intensity = frame_row[u];
      ++normal.candidates;
      const float trust = level.frame == observation.roi_pixels ? observation.weight(u, v) : 1.0F;
      if (std::isnan(intensity) || !(trust > 0.0F)) continue;
      const Eigen::Vector2d sensor(roi.x0 + FullFromLevel(u, level.frame_step), roi.y0 + FullFromLevel(v, level.frame_step));
      const Eigen::Vector2d scene = view.scene_from_sensor * sensor;
      const double x = LevelFromFull(scene.x() - reference.x0, level.reference_step);
      const double y = LevelFromFull(scene.y() - reference.y0, level.reference_step);
      if (!CubicSupported(*level.prediction, x, y)) continue;
      const float n = level.seen->at(static_cast<int>(x + 0.5), static_cast<int>(y + 0.5));
      if (!(n >= reference.seen_min)) continue;
      const double seen = trust * n / (n + 1.0);
      const ValueAndGradient p = SampleCubicGradient(*level.prediction, x, y);
      const double r = intensity - view.gain * p.value - view.offset;
      const double magnitude = std::abs(r);
      const double robust = magnitude <= huber ? 1.0 : huber / magnitude;
      if (residuals != nullptr) residuals->push_back(static_cast<float>(magnitude));
      ++normal.pixels;
      normal.weight += seen;
      normal.robust_weight += seen * robust;
      normal.sum_w_r2 += seen * robust * r * r;
      normal.cost += seen * (magnitude <= huber ? 0.5 * r * r : huber * (magnitude - 0.5 * huber)) * inverse_sigma2;
      normal.sum_i += seen * robust * intensity;
      normal.sum_i2 += seen * robust * intensity * intensity;
      // d(prediction)/d(sensor point): through M, in cells (level gradients are per level pixel).
      if (!affine) m = view.scene_from_sensor.LinearisedAt(sensor).linear;
      const double gx = view.gain * (p.dx * m(0, 0) + p.dy * m(1, 0)) / level.reference_step;
      const double gy = view.gain * (p.dx * m(0, 1) + p.dy * m(1, 1)) / level.reference_step;
      j.head(corners).noalias() = CornerJacobian(roi, sensor, model).transpose() * Eigen::Vector2d(gx, gy);
      j(corners) = p.value;
      j(corners + 1) = 1.0;
      const double scale = seen * robust * inverse_sigma2;
      row_a.noalias() += (scale * j) * j.transpose();
      row_b.noalias() += (scale * r) * j;
    }
    normal.a += row_a;
    normal.b += row_b;
  }
  return normal;
}

// Adds the prior's pull at `view`.
void AddPrior(const ViewPrior& prior, const View& view, const Roi& roi, Normal* normal) {
  const Eigen::Index n = prior.information.rows();
  const CornerVector d = CornerDisplacement(prior.mean.scene_from_sensor, view.scene_from_sensor, roi, ModelOf(n));
  normal->a.topLeftCorner(n, n) += prior.information;
  normal->b.head(n) -= prior.information * d;
  const double gain_information = 1.0 / (prior.gain_sigma * prior.gain_sigma);
  const double offset_information = 1.0 / (prior.offset_sigma * prior.offset_sigma);
  normal->a(n, n) += gain_information;
  normal->b(n) -= gain_information * (view.gain - prior.mean.gain);
  normal->a(n + 1, n + 1) += offset_information;
  normal->b(n + 1) -= offset_information * (view.offset - prior.mean.offset);
}

double OverlapOf(const Normal& normal) {
  return normal.candidates > 0 ? static_cast<double>(normal.pixels) / static_cast<double>(normal.candidates) : 0.0;
}

View Moved(const View& view, const Roi& roi, const Parameters& step) {
  const Eigen::Index n = step.size() - 2;
  return {Displace(view.scene_from_sensor, roi, step.head(n)), view.gain + step(n), view.offset + step(n + 1)};
}

// Iterates at one level from `view`; true when the last step was below the tolerance.
bool IterateLevel(const Observation& observation, const Reference& reference, const Level& level, const ViewPrior& prior,
                  const GaussNewtonOptions& options, double sigma, double tolerance_px, View* view) {
  for (int iteration = 0; iteration < options.iterations_max; ++iteration) {
    Normal normal = Accumulate(observation, reference, level, *view, sigma, options.huber_sigmas, ModelOf(prior.information.rows()), nullptr);
    if (OverlapOf(normal) < kOverlapMin) return false;
    AddPrior(prior, *view, observation.roi, &normal);
    // A trace of damping keeps an untextured ROI with a flat prior solvable.
    ParameterMatrix damped = normal.a;
    damped.diagonal() *= 1.0 + 1e-9;
    damped.diagonal().array() += 1e-9;
    const Parameters step = damped.ldlt().solve(normal.b);
    if (!step.allFinite()) return false;
    *view = Moved(*view, observation.roi, step);
    const double largest = step.head(step.size() - 2).cwiseAbs().maxCoeff();
    if (largest < tolerance_px) return true;
    // A step of a good part of the ROI is a divergence, not a registration.
    if (largest > 0.75 * std::max(observation.roi.width(), observation.roi.height())) return false;
  }
  return false;
}

Level FinestLevel(const Observation& observation, const Reference& reference) {
  return {observation.roi_pixels, reference.prediction, reference.seen, 1.0, 1.0, 1};
}

void Summarise(const Observation& observation, const Reference& reference, const ViewPrior& prior, double huber_sigmas,
               Registration* result) {
  const Eigen::Index n = prior.information.rows();
  std::vector<float> residuals;
  residuals.reserve(static_cast<std::size_t>(observation.roi.area()));
  Normal normal =
      Accumulate(observation, reference, FinestLevel(observation, reference), result->view, observation.noise_sigma, huber_sigmas, ModelOf(n), &residuals);
  result->overlap = OverlapOf(normal);
  if (result->overlap < kOverlapMin) {
    result->converged = false;
    result->corner_covariance = CornerMatrix::Zero(n, n);
    return;
  }
  result->residual_rms = std::sqrt(normal.sum_w_r2 / normal.robust_weight);
  auto middle = residuals.begin() + static_cast<std::ptrdiff_t>(residuals.size() / 2);
  std::nth_element(residuals.begin(), middle, residuals.end());
  result->residual_sigma = 1.4826 * *middle;
  const double mean = normal.sum_i / normal.robust_weight;
  const double variance = std::max(normal.sum_i2 / normal.robust_weight - mean * mean, 1e-12);
  result->correlation = std::sqrt(std::max(0.0, 1.0 - normal.sum_w_r2 / normal.robust_weight / variance));
  // The residuals, not the nominal noise, say how well this frame determines its view.
  const double inflation = std::max(1.0, std::pow(result->residual_rms / observation.noise_sigma, 2));
  normal.a /= inflation;
  AddPrior(prior, result->view, observation.roi, &normal);
  const ParameterMatrix covariance = normal.a.ldlt().solve(ParameterMatrix::Identity(n + 2, n + 2));
  result->corner_covariance = covariance.topLeftCorner(n, n);
  result->gain_offset_covariance = covariance.bottomRightCorner<2, 2>();
  result->motion_from_prior_px =
      LargestCornerMotion(prior.mean.scene_from_sensor, result->view.scene_from_sensor, observation.roi);
}

}  // namespace

Registration RegisterGaussNewton(const Observation& observation, const Reference& reference, const ViewPrior& prior, const View& start,
                                 const GaussNewtonOptions& options) {
  Registration result;
  result.view = start;
  // Level l averages 2^l sensor pixels of the frame and 2^(l + 1) cells of the reference: at three cells a pixel that is the nearest
  // halving to the same blur.
  std::vector<Image<float>> frames;
  std::vector<Image<float>> predictions;
  std::vector<Image<float>> seens;
  if (options.pyramid_levels > 0) {
    predictions.push_back(ReduceByTwo(*reference.prediction));
    seens.push_back(ReduceByTwoMinimum(*reference.seen));
  }
  for (int l = 1; l <= options.pyramid_levels; ++l) {
    const Image<float>& finer = l == 1 ? *observation.roi_pixels : frames.back();
    if (std::min(finer.width(), finer.height()) < 24) break;
    frames.push_back(ReduceByTwo(finer));
    predictions.push_back(ReduceByTwo(predictions.back()));
    seens.push_back(ReduceByTwoMinimum(seens.back()));
  }
  // Far from the solution the residuals are model error, not noise: the coarse levels' Huber scale is opened accordingly.
  for (std::size_t l = frames.size(); l > 0; --l) {
    const double step = static_cast<double>(1 << l);
    const Level level{&frames[l - 1], &predictions[l], &seens[l], step, 2.0 * step, 1};
    IterateLevel(observation, reference, level, prior, options, 3.0 * observation.noise_sigma, 0.02 * step, &result.view);
  }
  const Level finest = FinestLevel(observation, reference);
  if (observation.roi.area() >= 64 * 64) {
    // A ninth of the pixels carries enough to come close; the last iterations use every one.
    Level sparse = finest;
    sparse.pixel_stride = 3;
    IterateLevel(observation, reference, sparse, prior, options, observation.noise_sigma, 0.03, &result.view);
  }
  result.converged =
      IterateLevel(observation, reference, finest, prior, options, observation.noise_sigma, options.step_tolerance_px, &result.view);
  Summarise(observation, reference, prior, options.huber_sigmas, &result);
  return result;
}

Registration EvaluateView(const Observation& observation, const Reference& reference, const ViewPrior& prior, const View& view) {
  Registration result;
  result.view = view;
  Summarise(observation, reference, prior, GaussNewtonOptions{}.huber_sigmas, &result);
  return result;
}

}  // namespace trem
