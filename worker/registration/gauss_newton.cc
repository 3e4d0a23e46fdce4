#include "worker/registration/gauss_newton.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "worker/registration/normal_equations.h"
#include "worker/registration/reduce.h"

namespace trem {
namespace {

// Least part of the ROI's pixels that must have seen scene behind them for a step to mean anything.
constexpr double kOverlapMin = 0.05;
// The same for a start to be compared with others by its residuals.
constexpr double kScanOverlapMin = 0.4;

// Adds the prior's pull at `view`.
void AddPrior(const ViewPrior& prior, const View& view, const Roi& roi, NormalEquations* normal) {
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

// The slope of -1/2 log det A_go, A_go the information of gain and offset: what integrating them out adds to maximising over them.
// Call after AddPrior. Robust weights are held.
void AddMarginalisation(double noise_sigma, NormalEquations* normal) {
  const Eigen::Index n = normal->a.rows() - 2;
  const Eigen::Matrix2d covariance = normal->a.bottomRightCorner<2, 2>().inverse();
  const double inverse_variance = 1.0 / (noise_sigma * noise_sigma);
  if (!covariance.allFinite() || !normal->d_pp.allFinite()) return;
  normal->b.head(n) -= 0.5 * inverse_variance * (covariance(0, 0) * normal->d_pp + 2.0 * covariance(0, 1) * normal->d_p);
}

View Moved(const View& view, const Roi& roi, const Parameters& step) {
  const Eigen::Index n = step.size() - 2;
  return {Displace(view.scene_from_sensor, roi, step.head(n)), view.gain + step(n), view.offset + step(n + 1)};
}

// The normal equations at `view` with all that pulls on it.
NormalEquations EquationsAt(const RegistrationLevel& level, const Observation& observation, const Reference& reference,
                            const ViewPrior& prior, const GaussNewtonOptions& options, double sigma, const View& view,
                            ResidualHistogram* histogram) {
  return AccumulateNormal(level, observation.roi, reference, view, ModelOf(prior.information.rows()), sigma, options.huber_sigmas,
                          histogram);
}

// The last evaluation of the finest level and the step that was taken from it.
struct Evaluation {
  View view;               // Where it was made.
  NormalEquations normal;  // Without the prior.
  Parameters step;
  ResidualHistogram histogram;
};

// Far from the solution the residuals are model error, not noise: on reduced levels the scale follows their spread.
constexpr double kCoarseNoiseMin = 3.0;  // In the noise's sigma.
constexpr double kCoarseNoiseMax = 30.0;
// The histogram must hold residuals of a scale that is far too small.
constexpr double kSpreadProbe = 8.0;

double SpreadAt(const RegistrationLevel& level, const Observation& observation, const Reference& reference, const View& view,
                const GaussNewtonOptions& options, ViewModel model) {
  ResidualHistogram histogram;
  const double probe = kSpreadProbe * observation.noise_sigma;
  (void)AccumulateNormal(level, observation.roi, reference, view, model, probe, options.huber_sigmas, &histogram);
  const double spread = 1.4826 * probe * histogram.Median();
  return std::clamp(spread, kCoarseNoiseMin * observation.noise_sigma, kCoarseNoiseMax * observation.noise_sigma);
}

// Iterates at one level from `view`; true when the last step was below the tolerance. `last` (may be null) receives the last evaluation.
bool IterateLevel(const Observation& observation, const Reference& reference, const RegistrationLevel& level, const ViewPrior& prior,
                  const GaussNewtonOptions& options, double sigma, double tolerance_px, View* view, Evaluation* last) {
  for (int iteration = 0; iteration < options.iterations_max; ++iteration) {
    if (last != nullptr) last->histogram = {};
    NormalEquations normal =
        EquationsAt(level, observation, reference, prior, options, sigma, *view, last != nullptr ? &last->histogram : nullptr);
    if (last != nullptr) {
      last->view = *view;
      last->normal = normal;
      last->step = Parameters::Zero(normal.b.size());
    }
    if (normal.overlap() < kOverlapMin) return false;
    AddPrior(prior, *view, observation.roi, &normal);
    if (options.gain_offset == GainOffset::kMarginalised) AddMarginalisation(sigma, &normal);
    // A trace of damping keeps an untextured ROI with a flat prior solvable.
    ParameterMatrix damped = normal.a;
    damped.diagonal() *= 1.0 + 1e-9;
    damped.diagonal().array() += 1e-9;
    const Parameters step = damped.ldlt().solve(normal.b);
    if (!step.allFinite()) return false;
    const double largest = step.head(step.size() - 2).cwiseAbs().maxCoeff();
    // A step of a good part of the ROI is a divergence, not a registration.
    if (largest > 0.75 * std::max(observation.roi.width(), observation.roi.height())) return false;
    *view = Moved(*view, observation.roi, step);
    if (!view->scene_from_sensor.linear.allFinite() || !view->scene_from_sensor.perspective.allFinite()) return false;
    if (last != nullptr) last->step = step;
    if (largest < tolerance_px) return true;
  }
  return false;
}

// Mean square of the residuals at `view` [grey levels^2] after the gain and offset that fit best; infinite with little overlap.
double ProfiledSquare(const RegistrationLevel& level, const Observation& observation, const Reference& reference, const View& view,
                      double sigma, const GaussNewtonOptions& options, ViewModel model) {
  const NormalEquations normal = AccumulateNormal(level, observation.roi, reference, view, model, sigma, options.huber_sigmas, nullptr);
  if (normal.overlap() < kScanOverlapMin || !(normal.robust_weight > 0.0)) return std::numeric_limits<double>::infinity();
  Eigen::Matrix2d information = normal.a.bottomRightCorner<2, 2>();
  information.diagonal() *= 1.0 + 1e-9;
  const Eigen::Vector2d pull = normal.b.tail<2>();
  const double explained = pull.dot(information.ldlt().solve(pull)) * sigma * sigma;
  return std::max(0.0, normal.sum_w_r2 - explained) / normal.robust_weight;
}

// `start` turned about the ROI's centre and moved, in the sensor.
View TurnedAndMoved(const View& start, const Roi& roi, double angle_rad, const Eigen::Vector2d& motion_px) {
  const Eigen::Vector2d centre(0.5 * (roi.x0 + roi.x1 - 1), 0.5 * (roi.y0 + roi.y1 - 1));
  Affine moved;
  moved.linear << std::cos(angle_rad), -std::sin(angle_rad), std::sin(angle_rad), std::cos(angle_rad);
  moved.offset = centre - moved.linear * centre + motion_px;
  View view = start;
  view.scene_from_sensor = start.scene_from_sensor * PlanarMap(moved);
  return view;
}

// The best start for the coarsest level: a grid of translations two level pixels apart, each turned three ways, within the capture range;
// the three with the least residuals are iterated and the best of what comes out is taken. `start` itself is on the grid.
View ScanStarts(const RegistrationLevel& level, const Observation& observation, const Reference& reference, const ViewPrior& wide,
                const GaussNewtonOptions& options, double sigma, const View& start) {
  constexpr double kTurnRad = 0.16;  // 9 degrees.
  constexpr std::size_t kTried = 3;
  const ViewModel model = ModelOf(wide.information.rows());
  const double spacing = 2.0 * level.frame_step;
  const int reach = static_cast<int>(std::round(options.capture_sigma_px / spacing));
  std::vector<std::pair<double, View>> scanned;
  for (int turn = -1; turn <= 1; ++turn) {
    for (int dy = -reach; dy <= reach; ++dy) {
      for (int dx = -reach; dx <= reach; ++dx) {
        const View view = TurnedAndMoved(start, observation.roi, kTurnRad * turn, spacing * Eigen::Vector2d(dx, dy));
        scanned.emplace_back(ProfiledSquare(level, observation, reference, view, sigma, options, model), view);
      }
    }
  }
  std::stable_sort(scanned.begin(), scanned.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  std::pair<double, View> best{std::numeric_limits<double>::infinity(), start};
  for (std::size_t k = 0; k < std::min(kTried, scanned.size()); ++k) {
    View view = scanned[k].second;
    IterateLevel(observation, reference, level, wide, options, sigma, 0.02 * level.frame_step, &view, nullptr);
    const double square = ProfiledSquare(level, observation, reference, view, sigma, options, model);
    if (square < best.first) best = {square, view};
  }
  return best.second;
}

RegistrationLevel FinestLevel(const Observation& observation, const Reference& reference, int threads = 1) {
  return {observation.roi_pixels, observation.weights, reference.prediction, reference.seen, 1.0, 1.0, 1, threads};
}

// What the last evaluation says of the view that its step led to.
void Summarise(const Observation& observation, const Reference& reference, const ViewPrior& prior, const Evaluation& last,
               Registration* result) {
  const Eigen::Index n = prior.information.rows();
  NormalEquations normal = last.normal;
  result->corner_covariance = CornerMatrix::Zero(n, n);
  result->overlap = normal.overlap();
  if (result->overlap < kOverlapMin || !(normal.robust_weight > 0.0)) {
    result->converged = false;
    return;
  }
  const double variance_noise = observation.noise_sigma * observation.noise_sigma;
  // The residuals' sum of squares after the step, to second order.
  const double gained = variance_noise * (2.0 * last.step.dot(normal.b) - last.step.dot(normal.a * last.step));
  const double squares = std::max(normal.sum_w_r2 - gained, 0.0);
  result->residual_rms = std::sqrt(squares / normal.robust_weight);
  result->residual_sigma = 1.4826 * observation.noise_sigma * last.histogram.Median();
  const double mean = normal.sum_w_i / normal.robust_weight;
  const double variance = std::max(normal.sum_w_i2 / normal.robust_weight - mean * mean, 1e-12);
  result->correlation = std::sqrt(std::max(0.0, 1.0 - squares / normal.robust_weight / variance));
  // The residuals, not the nominal noise, say how well this frame determines its view.
  const double inflation = std::max(1.0, std::pow(result->residual_rms / observation.noise_sigma, 2));
  normal.a /= inflation;
  result->support = MeasureSupport(observation, reference, result->view);
  const ParameterMatrix data = normal.a;
  AddPrior(prior, result->view, observation.roi, &normal);
  const ParameterMatrix inverse = normal.a.ldlt().solve(ParameterMatrix::Identity(n + 2, n + 2));
  const ParameterMatrix covariance = inverse * (normal.a - (1.0 - result->support.own_share) * data) * inverse;
  result->corner_covariance = covariance.topLeftCorner(n, n);
  result->gain_offset_covariance = covariance.bottomRightCorner<2, 2>();
  result->motion_from_prior_px = LargestCornerMotion(prior.mean.scene_from_sensor, result->view.scene_from_sensor, observation.roi);
}

// A frame and a reference reduced by 2, 4, ... Level l averages 2^l sensor pixels of the frame and 2^(l + 1) cells of the reference: at
// three cells a pixel that is the nearest halving to the same blur.
struct Pyramid {
  std::vector<WeightedImage> frames;  // Levels 1, 2, ...
  std::vector<Image<float>> predictions;
  std::vector<Image<float>> seens;
};

Pyramid MakePyramid(const Observation& observation, const Reference& reference, int levels) {
  Pyramid pyramid;
  if (levels == 0) return pyramid;
  pyramid.predictions.push_back(ReduceByTwo(*reference.prediction));
  pyramid.seens.push_back(ReduceByTwoMinimum(*reference.seen));
  for (int l = 1; l <= levels; ++l) {
    const Image<float>& finer = l == 1 ? *observation.roi_pixels : pyramid.frames.back().pixels;
    const Image<float>* weights = l == 1 ? observation.weights : &pyramid.frames.back().weights;
    if (std::min(finer.width(), finer.height()) < 24) break;
    pyramid.frames.push_back(ReduceByTwoWeighted(finer, weights));
    pyramid.predictions.push_back(ReduceByTwo(pyramid.predictions.back()));
    pyramid.seens.push_back(ReduceByTwoMinimum(pyramid.seens.back()));
  }
  return pyramid;
}

}  // namespace

Registration RegisterGaussNewton(const Observation& observation, const Reference& reference, const ViewPrior& prior, const View& start,
                                 const GaussNewtonOptions& options) {
  Registration result;
  result.view = start;
  const Pyramid pyramid = MakePyramid(observation, reference, options.pyramid_levels);
  ViewPrior wide = prior;
  wide.mean = start;
  wide.information = CornerMatrix::Identity(prior.information.rows(), prior.information.rows()) / std::pow(options.capture_sigma_px, 2);
  for (std::size_t l = pyramid.frames.size(); l > 0; --l) {
    const double step = static_cast<double>(1 << l);
    const WeightedImage& frame = pyramid.frames[l - 1];
    const RegistrationLevel level{&frame.pixels, &frame.weights, &pyramid.predictions[l], &pyramid.seens[l], step, 2.0 * step, 1};
    const double sigma = SpreadAt(level, observation, reference, result.view, options, ModelOf(prior.information.rows()));
    if (l == pyramid.frames.size()) result.view = ScanStarts(level, observation, reference, wide, options, sigma, start);
    IterateLevel(observation, reference, level, wide, options, sigma, 0.02 * step, &result.view, nullptr);
  }
  const RegistrationLevel finest = FinestLevel(observation, reference, options.threads);
  // A part of the pixels carries enough to come close; the last iterations use every one.
  for (const int stride : {6, 3}) {
    const int side = std::min(observation.roi.width(), observation.roi.height()) / stride;
    if (side < 21) continue;
    RegistrationLevel sparse = finest;
    sparse.pixel_stride = stride;
    IterateLevel(observation, reference, sparse, prior, options, observation.noise_sigma, stride == 6 ? 0.2 : 0.05, &result.view, nullptr);
  }
  Evaluation last;
  result.converged =
      IterateLevel(observation, reference, finest, prior, options, observation.noise_sigma, options.step_tolerance_px, &result.view, &last);
  Summarise(observation, reference, prior, last, &result);
  return result;
}

Registration EvaluateView(const Observation& observation, const Reference& reference, const ViewPrior& prior, const View& view) {
  Registration result;
  result.view = view;
  Evaluation last;
  last.view = view;
  last.normal =
      EquationsAt(FinestLevel(observation, reference), observation, reference, prior, {}, observation.noise_sigma, view, &last.histogram);
  last.step = Parameters::Zero(last.normal.b.size());
  Summarise(observation, reference, prior, last, &result);
  return result;
}

}  // namespace trem
