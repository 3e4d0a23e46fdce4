#include "worker/tre/landweber_update.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "worker/sensor/bicubic.h"

namespace trem {
namespace {

// Cells seen by fewer frames have nothing to be an outlier of.
constexpr float kKnownFrames = 1.5F;
// Reach of the bicubic stencil.
constexpr int kStencil = 2;

void FitSize(const Image<float>& like, Image<float>* image) {
  if (image->width() != like.width() || image->height() != like.height()) *image = Image<float>(like.width(), like.height());
}

// The bicubic stencil at (x, y) [buffer].
struct Stencil {
  Stencil(double x, double y)
      : ix(static_cast<int>(x)),
        iy(static_cast<int>(y)),
        wx(CubicWeights(static_cast<float>(x - ix))),
        wy(CubicWeights(static_cast<float>(y - iy))) {}

  template <typename Weight>
  void Add(float value, const Weight& weight, Image<float>* image) const {
    for (std::size_t j = 0; j < 4; ++j) {
      float* p = image->row(iy - 1 + static_cast<int>(j)) + ix - 1;
      for (std::size_t i = 0; i < 4; ++i) p[i] += value * weight(wx[i] * wy[j]);
    }
  }
  float AbsoluteSum() const {
    float x_sum = 0.0F;
    float y_sum = 0.0F;
    for (std::size_t i = 0; i < 4; ++i) {
      x_sum += std::abs(wx[i]);
      y_sum += std::abs(wy[i]);
    }
    return x_sum * y_sum;
  }

  int ix;
  int iy;
  std::array<float, 4> wx;
  std::array<float, 4> wy;
};

// Calls visit(x, y, u, v) for the frame's usable pixels whose bicubic stencil lies in the buffer and touches `region` [buffer].
template <typename Visit>
void ForEachPixel(const KeptFrame& frame, const Roi& region, const SceneBuffer& buffer, const Visit& visit) {
  const Roi reach = Grown(region, kStencil);
  for (int v = 0; v < frame.roi.height(); ++v) {
    for (int u = 0; u < frame.roi.width(); ++u) {
      if (std::isnan(frame.pixels.at(u, v)) || (!frame.weights.empty() && !(frame.weights.at(u, v) > 0.0F))) continue;
      const Eigen::Vector2d cell = frame.view.scene_from_sensor * Eigen::Vector2d(frame.roi.x0 + u, frame.roi.y0 + v);
      const double x = cell.x() - buffer.extent.x0;
      const double y = cell.y() - buffer.extent.y0;
      if (!(x >= reach.x0 && x < reach.x1 && y >= reach.y0 && y < reach.y1) || !CubicSupported(buffer.scene, x, y)) continue;
      visit(x, y, u, v);
    }
  }
}

}  // namespace

void LandweberUpdate::AddFrame(int frame_index, const Observation& observation, const View& view) {
  if (frames_.size() == static_cast<std::size_t>(options_.window)) frames_.erase(frames_.begin());
  frames_.push_back({frame_index, observation.roi, observation.noise_sigma, *observation.roi_pixels,
                     observation.weights != nullptr ? *observation.weights : Image<float>{}, view});
}

float LandweberUpdate::CurvatureBound(const Roi& inner, const SceneBuffer& buffer) {
  const Roi whole{0, 0, buffer.scene.width(), buffer.scene.height()};
  const Roi context = Intersect(Grown(inner, blur_.psf().radius()), whole);
  std::fill(splatted_.pixels().begin(), splatted_.pixels().end(), 0.0F);
  for (const KeptFrame& frame : frames_) {
    const float gain2 = static_cast<float>(frame.view.gain * frame.view.gain);
    ForEachPixel(frame, context, buffer, [&](double x, double y, int u, int v) {
      const Stencil stencil(x, y);
      const float trust = frame.weights.empty() ? 1.0F : frame.weights.at(u, v);
      stencil.Add(
          trust * gain2 * stencil.AbsoluteSum(), [](float w) { return std::abs(w); }, &splatted_);
    });
  }
  blur_.ApplyAdjoint(splatted_, inner, &gradient_);
  float largest = 0.0F;
  float largest_splat = 0.0F;
  for (int y = context.y0; y < context.y1; ++y) {
    for (int x = context.x0; x < context.x1; ++x) {
      largest_splat = std::max(largest_splat, splatted_.at(x, y));
      if (inner.Contains(x, y)) largest = std::max(largest, gradient_.at(x, y));
    }
  }
  // |B| = B + 2 N for a PSF with a little negative mass n; see InformationUpdate::AddNegativePart.
  const float n = static_cast<float>(blur_.psf().negative_mass);
  return (1.0F + 2.0F * n) * (largest + 8.0F * n * largest_splat);
}

void LandweberUpdate::SplatResiduals(const Roi& context, const SceneBuffer& buffer) {
  std::fill(splatted_.pixels().begin(), splatted_.pixels().end(), 0.0F);
  for (const KeptFrame& frame : frames_) {
    const float gain = static_cast<float>(frame.view.gain);
    const float offset = static_cast<float>(frame.view.offset);
    const float limit = static_cast<float>(options_.huber_sigmas * frame.noise_sigma);
    ForEachPixel(frame, context, buffer, [&](double x, double y, int u, int v) {
      const float trust = frame.weights.empty() ? 1.0F : frame.weights.at(u, v);
      float residual = gain * SampleCubic(blurred_, x, y) + offset - frame.pixels.at(u, v);
      const bool known = buffer.seen.at(static_cast<int>(x + 0.5), static_cast<int>(y + 0.5)) >= kKnownFrames;
      if (known) residual = std::clamp(residual, -limit, limit);
      Stencil(x, y).Add(
          trust * gain * residual, [](float w) { return w; }, &splatted_);
    });
  }
}

void LandweberUpdate::Iterate(const Roi& region, int iterations, const StructurePrior& prior, float lambda, SceneBuffer* buffer) {
  const Roi inner = buffer->InBuffer(region);
  if (inner.empty() || frames_.empty()) return;
  FitSize(buffer->scene, &blurred_);
  FitSize(buffer->scene, &splatted_);
  FitSize(buffer->scene, &gradient_);
  const int radius = blur_.psf().radius();
  const Roi whole{0, 0, buffer->scene.width(), buffer->scene.height()};
  const Roi context = Intersect(Grown(inner, radius), whole);
  const Roi sampled = Intersect(Grown(context, 2 * kStencil), whole);
  double seen = 0.0;
  double count = 0.0;
  for (int y = inner.y0; y < inner.y1; y += 2) {
    for (int x = inner.x0; x < inner.x1; x += 2) {
      if (buffer->seen.at(x, y) < 0.5F) continue;
      seen += buffer->seen.at(x, y);
      count += 1.0;
    }
  }
  const float kept = static_cast<float>(frames_.size());
  const float frames_seen = count > 0.0 ? static_cast<float>(seen / count) : kept;
  const float weight = lambda * std::min(1.0F, kept / frames_seen);
  const float step = static_cast<float>(options_.relaxation) / (CurvatureBound(inner, *buffer) + weight * prior.curvature_max() + 1e-6F);
  for (int iteration = 0; iteration < iterations; ++iteration) {
    blur_.Apply(buffer->scene, sampled, &blurred_);
    SplatResiduals(context, *buffer);
    blur_.ApplyAdjoint(splatted_, inner, &gradient_);
    prior.AddGradient(buffer->scene, inner, weight, &gradient_);
    for (int y = inner.y0; y < inner.y1; ++y) {
      const float* g = gradient_.row(y);
      float* scene = buffer->scene.row(y);
      for (int x = inner.x0; x < inner.x1; ++x) scene[x] -= step * g[x];
    }
  }
}

}  // namespace trem
