#include "tests/support/batch_map.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "worker/sensor/bicubic.h"
#include "worker/sensor/blur.h"

namespace trem::testing {
namespace {

// Calls visit(x, y, gain, offset, weight, value) for every pixel that takes part, (x, y) its place in the extent.
template <typename Visit>
void ForEachSample(const Roi& extent, std::span<const BatchFrame> frames, const Visit& visit) {
  const Image<float> size(extent.width(), extent.height());
  for (const BatchFrame& frame : frames) {
    const Observation& o = frame.observation;
    for (int v = 0; v < o.roi.height(); ++v) {
      for (int u = 0; u < o.roi.width(); ++u) {
        const float value = o.roi_pixels->at(u, v);
        const float weight = o.weight(u, v);
        if (std::isnan(value) || !(weight > 0.0F)) continue;
        const Eigen::Vector2d cell = frame.view.scene_from_sensor * Eigen::Vector2d(o.roi.x0 + u, o.roi.y0 + v);
        const double x = cell.x() - extent.x0;
        const double y = cell.y() - extent.y0;
        if (CubicSupported(size, x, y)) {
          visit(x, y, static_cast<float>(frame.view.gain), static_cast<float>(frame.view.offset), weight, value);
        }
      }
    }
  }
}

// Adds value * |weights|^power of the bicubic stencil at (x, y).
template <bool kAbsolute>
void Splat(double x, double y, float value, Image<float>* image) {
  const int ix = static_cast<int>(x);
  const int iy = static_cast<int>(y);
  const std::array<float, 4> wx = CubicWeights(static_cast<float>(x - ix));
  const std::array<float, 4> wy = CubicWeights(static_cast<float>(y - iy));
  for (std::size_t j = 0; j < 4; ++j) {
    float* p = image->row(iy - 1 + static_cast<int>(j)) + ix - 1;
    for (std::size_t i = 0; i < 4; ++i) {
      const float w = wx[i] * wy[j];
      p[i] += value * (kAbsolute ? std::abs(w) : w);
    }
  }
}

float AbsoluteSum(double t) {
  float sum = 0.0F;
  for (const float w : CubicWeights(static_cast<float>(t - std::floor(t)))) sum += std::abs(w);
  return sum;
}

}  // namespace

Image<float> BatchMap(const SeparablePsf& psf, const Roi& extent, std::span<const BatchFrame> frames, const BatchMapOptions& options,
                      Image<float> start) {
  const int width = extent.width();
  const int height = extent.height();
  TREM_CHECK(start.width() == width && start.height() == height);
  const Roi whole{0, 0, width, height};
  const float lambda = static_cast<float>(options.weight);
  Blur blur(psf);
  Image<float> splatted(width, height);
  ForEachSample(extent, frames, [&](double x, double y, float gain, float, float weight, float) {
    Splat<true>(x, y, weight * gain * gain * AbsoluteSum(x) * AbsoluteSum(y), &splatted);
  });
  Image<float> metric(width, height);
  blur.ApplyAdjoint(splatted, &metric);
  const Image<float> reached = metric;
  for (float& m : metric.pixels()) m += lambda * options.prior.curvature_max() + 1e-6F;

  Image<float> now = std::move(start);
  Image<float> before = now;
  Image<float> look = now;
  Image<float> blurred(width, height);
  Image<float> gradient(width, height);
  double t = 1.0;
  for (int iteration = 0; iteration < options.iterations_max; ++iteration) {
    blur.Apply(look, &blurred);
    std::fill(splatted.pixels().begin(), splatted.pixels().end(), 0.0F);
    ForEachSample(extent, frames, [&](double x, double y, float gain, float offset, float weight, float value) {
      Splat<false>(x, y, weight * gain * (gain * SampleCubic(blurred, x, y) + offset - value), &splatted);
    });
    blur.ApplyAdjoint(splatted, &gradient);
    options.prior.AddGradient(look, whole, lambda, &gradient);
    before = now;
    double uphill = 0.0;
    float moved = 0.0F;
    for (std::size_t i = 0; i < now.pixels().size(); ++i) {
      now.pixels()[i] = look.pixels()[i] - gradient.pixels()[i] / metric.pixels()[i];
      const float step = now.pixels()[i] - before.pixels()[i];
      uphill += static_cast<double>(gradient.pixels()[i]) * step;
      if (reached.pixels()[i] > 0.05F) moved = std::max(moved, std::abs(step));
    }
    if (moved < options.tolerance && iteration > 10) break;
    if (uphill > 0.0) t = 1.0;
    const double next = 0.5 * (1.0 + std::sqrt(1.0 + 4.0 * t * t));
    const float momentum = static_cast<float>((t - 1.0) / next);
    t = next;
    for (std::size_t i = 0; i < now.pixels().size(); ++i) {
      look.pixels()[i] = now.pixels()[i] + momentum * (now.pixels()[i] - before.pixels()[i]);
    }
  }
  return now;
}

}  // namespace trem::testing
