#include "worker/tre/curvature_bound.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace trem {
namespace {

// Widths of the Gaussians that are tried, relative to the taps' own.
constexpr double kWidths[] = {1.05, 1.1, 1.15, 1.2, 1.3, 1.4, 1.6};
// What single precision and a place that is rounded to the other side may add.
constexpr double kRounding = 1.01;
constexpr double kCurvatureMax = 1e6;

double WeightMax(const Observation& observation) {
  if (observation.weights == nullptr) return 1.0;
  float most = 0.0F;
  for (const float weight : observation.weights->pixels()) most = weight > most ? weight : most;  // Not NaN.
  return most;
}

// The samples' places keep so far from the border of `extent` that the PSF, reflected there, reaches no cell twice.
bool StaysClear(const PlanarMap& map, const Roi& roi, const Roi& extent, int radius) {
  for (const int x : {roi.x0, roi.x1 - 1}) {
    for (const int y : {roi.y0, roi.y1 - 1}) {
      const Eigen::Vector2d cell = map * Eigen::Vector2d(x, y);
      if (!(cell.x() >= extent.x0 + radius + 1 && cell.x() <= extent.x1 - radius - 2)) return false;
      if (!(cell.y() >= extent.y0 + radius + 1 && cell.y() <= extent.y1 - radius - 2)) return false;
    }
  }
  return true;
}

}  // namespace

CurvatureBound::CurvatureBound(const Psf& psf) : radius_(psf.radius()) {
  if (!psf.is_rank_one_symmetric()) return;
  double variance = 0.0;
  for (int i = 1; i <= radius_; ++i) variance += 2.0 * i * i * std::max(psf.taps[static_cast<std::size_t>(i)], 0.0F);
  for (const double width : kWidths) {
    // Taps of a single cell have no width: half a cell's.
    const double sigma = width * std::max(std::sqrt(variance), 0.5);
    double most = 0.0;
    for (int i = 0; i <= radius_; ++i) {
      const double edge = (i + 0.5) / sigma;
      const double gaussian = std::exp(-0.5 * edge * edge) / (std::sqrt(2.0 * std::numbers::pi) * sigma);
      most = std::max(most, psf.taps[static_cast<std::size_t>(i)] / gaussian);
    }
    envelopes_.push_back({sigma, most * most});
  }
}

float CurvatureBound::Of(const Observation& observation, const View& view, const Roi& extent) const {
  constexpr float kNone = std::numeric_limits<float>::infinity();
  const PlanarMap& map = view.scene_from_sensor;
  const double cells = std::abs(map.linear.determinant());
  if (envelopes_.empty() || !map.IsAffine() || !(cells > 1e-3)) return kNone;
  // The longest step: the larger singular value of the map.
  const double squares = map.linear.squaredNorm();
  const double longest2 = 0.5 * (squares + std::sqrt(std::max(squares * squares - 4.0 * cells * cells, 0.0)));
  double least = std::numeric_limits<double>::infinity();
  for (const Envelope& envelope : envelopes_) {
    const double q = std::exp(-2.0 * std::numbers::pi * std::numbers::pi * envelope.sigma * envelope.sigma / longest2);
    const double aliases = 1.0 + 2.0 * q / (1.0 - q);
    least = std::min(least, envelope.factor * aliases * aliases);
  }
  // Reflected at two sides, the PSF puts a sample on a cell up to four times.
  const double folds = StaysClear(map, observation.roi, extent, radius_) ? 1.0 : 4.0;
  const double bound = kRounding * folds * least * view.gain * view.gain * WeightMax(observation) / cells;
  return bound < kCurvatureMax ? static_cast<float>(bound) : kNone;
}

}  // namespace trem
