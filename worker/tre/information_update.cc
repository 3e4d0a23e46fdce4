#include "worker/tre/information_update.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "worker/sensor/bicubic.h"

namespace trem {
namespace {

void FitSize(const Image<float>& like, Image<float>* image) {
  if (image->width() != like.width() || image->height() != like.height()) *image = Image<float>(like.width(), like.height());
}

Roi Grown(const Roi& roi, int by) { return {roi.x0 - by, roi.y0 - by, roi.x1 + by, roi.y1 + by}; }

// Cells beyond the last samples of many frames of a fixed camera are fitted through the PSF's tails, but not determined by the data: what
// they hold is amplified noise. They count as not seen when less than this part of the samples about them lies within half a sensor
// pixel. Where few frames were seen, samples are sparse and the test would punch holes.
constexpr float kManyFrames = 3.0F;
constexpr float kNearPartMin = 0.25F;

// Keeps the step finite where nothing is known: no samples and no prior.
constexpr float kCurvatureMin = 1e-6F;

// Iterations that one sweep over a tile carries out.
constexpr std::size_t kStepsPerSweep = 4;
// Tiles keep a sweep's window of rows in the second-level cache. Up to this many columns a region is one tile.
constexpr int kTileWidth = 1024;

// `region` cut into tiles of equal width.
std::vector<Roi> Tiles(const Roi& region) {
  const int count = (region.width() + kTileWidth - 1) / kTileWidth;
  std::vector<Roi> tiles;
  for (int i = 0; i < count; ++i) {
    tiles.push_back({region.x0 + region.width() * i / count, region.y0, region.x0 + region.width() * (i + 1) / count, region.y1});
  }
  return tiles;
}

// to = from outside `region`.
void CopyOutside(const Image<float>& from, const Roi& region, Image<float>* to) {
  for (int y = 0; y < from.height(); ++y) {
    const float* source = from.row(y);
    float* target = to->row(y);
    if (y < region.y0 || y >= region.y1) {
      std::copy(source, source + from.width(), target);
      continue;
    }
    std::copy(source, source + region.x0, target);
    std::copy(source + region.x1, source + from.width(), target + region.x1);
  }
}

float NearWeight(const Image<float>& weight, int x, int y, int reach) {
  float sum = 0.0F;
  for (int j = std::max(y - reach, 0); j <= std::min(y + reach, weight.height() - 1); ++j) {
    for (int i = std::max(x - reach, 0); i <= std::min(x + reach, weight.width() - 1); ++i) sum += weight.at(i, j);
  }
  return sum;
}

}  // namespace

void InformationUpdate::AddFrame(const Observation& observation, const View& view, const Roi& region, SceneBuffer* buffer) const {
  if (options_.forgetting < 1.0) {
    const Roi inner = buffer->InBuffer(region);
    const float factor = static_cast<float>(options_.forgetting);
    for (int y = inner.y0; y < inner.y1; ++y) {
      for (int x = inner.x0; x < inner.x1; ++x) {
        buffer->weight.at(x, y) *= factor;
        buffer->weighted.at(x, y) *= factor;
      }
    }
  }
  const Roi& roi = observation.roi;
  const float gain = static_cast<float>(view.gain);
  const float offset = static_cast<float>(view.offset);
  const float limit = static_cast<float>(options_.huber_sigmas * observation.noise_sigma);
  for (int v = 0; v < roi.height(); ++v) {
    const float* pixels = observation.roi_pixels->row(v);
    for (int u = 0; u < roi.width(); ++u) {
      const float trust = observation.weight(u, v);
      if (std::isnan(pixels[u]) || !(trust > 0.0F)) continue;
      const Eigen::Vector2d scene = view.scene_from_sensor * Eigen::Vector2d(roi.x0 + u, roi.y0 + v);
      const double x = scene.x() - buffer->extent.x0;
      const double y = scene.y() - buffer->extent.y0;
      if (!CubicSupported(buffer->prediction, x, y)) continue;
      const int cx = static_cast<int>(x + 0.5);
      const int cy = static_cast<int>(y + 0.5);
      const float predicted = SampleCubic(buffer->prediction, x, y);
      const float value = (pixels[u] - offset) / gain;
      const float residual = gain * (value - predicted);
      // The first look at a cell has nothing to be an outlier of.
      const bool known = buffer->seen.at(cx, cy) >= 1.5F;
      const float robust = known && std::abs(residual) > limit ? limit / std::abs(residual) : 1.0F;
      const float weight = trust * robust * gain * gain;
      // Residual correction: the sample is carried from where it was taken to the cell's centre along the model's own slope.
      buffer->weight.at(cx, cy) += weight;
      buffer->weighted.at(cx, cy) += weight * (value - predicted + buffer->prediction.at(cx, cy));
    }
  }
}

void InformationUpdate::UpdateSeen(const Roi& region, int ratio, SceneBuffer* buffer) {
  const Roi inner = buffer->InBuffer(region);
  blur_.ApplyAdjoint(buffer->weight, inner, &buffer->majoriser);
  AddNegativePart(inner, buffer);
  // Tents one sensor pixel wide to either side: the samples of one frame add up to 1 everywhere inside its ROI.
  FitSize(buffer->weight, &row_sums_);
  const Roi whole{0, 0, buffer->weight.width(), buffer->weight.height()};
  const Roi rows = Intersect(Grown(inner, ratio - 1), whole);
  const float scale = 1.0F / static_cast<float>(ratio * ratio);
  for (int y = rows.y0; y < rows.y1; ++y) {
    const float* weight = buffer->weight.row(y);
    float* sums = row_sums_.row(y);
    for (int x = inner.x0; x < inner.x1; ++x) {
      float sum = 0.0F;
      const int first = std::max(x - ratio + 1, 0);
      const int last = std::min(x + ratio - 1, whole.x1 - 1);
      for (int i = first; i <= last; ++i) sum += static_cast<float>(ratio - std::abs(x - i)) * weight[i];
      sums[x] = sum;
    }
  }
  for (int y = inner.y0; y < inner.y1; ++y) {
    float* seen = buffer->seen.row(y);
    std::fill(seen + inner.x0, seen + inner.x1, 0.0F);
    for (int j = std::max(y - ratio + 1, 0); j <= std::min(y + ratio - 1, whole.y1 - 1); ++j) {
      const float* sums = row_sums_.row(j);
      const float tent = scale * static_cast<float>(ratio - std::abs(y - j));
      for (int x = inner.x0; x < inner.x1; ++x) seen[x] += tent * sums[x];
    }
    for (int x = inner.x0; x < inner.x1; ++x) {
      if (seen[x] >= kManyFrames && NearWeight(buffer->weight, x, y, ratio / 2) < kNearPartMin * seen[x]) seen[x] = 0.0F;
    }
  }
}

void InformationUpdate::AddNegativePart(const Roi& inner, SceneBuffer* buffer) const {
  const float negative = static_cast<float>(blur_.psf().negative_mass);
  if (negative == 0.0F) return;
  const Roi whole{0, 0, buffer->weight.width(), buffer->weight.height()};
  const Roi read = Intersect(Grown(inner, blur_.psf().radius()), whole);
  float weight_max = 0.0F;
  for (int y = read.y0; y < read.y1; ++y) {
    for (int x = read.x0; x < read.x1; ++x) weight_max = std::max(weight_max, buffer->weight.at(x, y));
  }
  const float factor = 1.0F + 2.0F * negative;
  const float floor = 8.0F * negative * weight_max;
  for (int y = inner.y0; y < inner.y1; ++y) {
    for (int x = inner.x0; x < inner.x1; ++x) buffer->majoriser.at(x, y) = factor * (std::max(buffer->majoriser.at(x, y), 0.0F) + floor);
  }
}

void InformationUpdate::Predict(const Roi& region, SceneBuffer* buffer) {
  blur_.Apply(buffer->scene, buffer->InBuffer(region), &buffer->prediction);
}

float InformationUpdate::NextMomentum() {
  const float momentum = static_cast<float>(std::min(options_.momentum_max, steps_ / (steps_ + 3.0)));
  ++steps_;
  return momentum;
}

void InformationUpdate::Iterate(const Roi& region, int iterations, float lambda, SceneBuffer* buffer) {
  const Roi inner = buffer->InBuffer(region);
  if (inner.empty()) return;
  const bool known_prior = options_.prior.kind == StructurePriorKind::kHuberTv || options_.prior.kind == StructurePriorKind::kMembrane;
  if (iterations < 1) {
    Predict(region, buffer);
  } else if (options_.fused && known_prior && blur_.psf().is_rank_one_symmetric()) {
    IterateFused(inner, iterations, lambda, buffer);
  } else {
    IterateInPasses(inner, iterations, lambda, buffer);
    Predict(region, buffer);
  }
}

void InformationUpdate::IterateFused(const Roi& inner, int iterations, float lambda, SceneBuffer* buffer) {
  StepWeights weights;
  weights.lambda = lambda;
  weights.limit = options_.prior.kind == StructurePriorKind::kHuberTv ? options_.prior.delta : std::numeric_limits<float>::max();
  weights.damping = lambda * StructurePrior::kCurvatureMax + kCurvatureMin;
  const std::vector<Roi> tiles = Tiles(inner);
  const bool in_place = tiles.size() == 1;
  if (!in_place) {
    FitSize(buffer->scene, &next_scene_);
    FitSize(buffer->scene, &next_previous_);
  }
  std::vector<float> momenta;
  while (iterations > 0) {
    momenta.clear();
    for (; iterations > 0 && momenta.size() < kStepsPerSweep; --iterations) momenta.push_back(NextMomentum());
    SweepPlanes planes{&buffer->scene, &buffer->previous, &buffer->weight, &buffer->weighted, &buffer->majoriser};
    planes.next_scene = in_place ? &buffer->scene : &next_scene_;
    planes.next_previous = in_place ? &buffer->previous : &next_previous_;
    planes.prediction = iterations == 0 ? &buffer->prediction : nullptr;
    for (const Roi& tile : tiles) sweep_.Run(planes, inner, tile, momenta, weights);
    if (in_place) continue;
    CopyOutside(buffer->scene, inner, &next_scene_);
    CopyOutside(buffer->previous, inner, &next_previous_);
    std::swap(buffer->scene, next_scene_);
    std::swap(buffer->previous, next_previous_);
  }
}

void InformationUpdate::IterateInPasses(const Roi& inner, int iterations, float lambda, SceneBuffer* buffer) {
  FitSize(buffer->scene, &extrapolated_);
  FitSize(buffer->scene, &residual_);
  FitSize(buffer->scene, &gradient_);
  // The gradient in the region reads residuals a radius beyond it, and those read the scene a radius further; there it stays unmoved.
  const Roi whole{0, 0, buffer->scene.width(), buffer->scene.height()};
  const Roi context = Intersect(Grown(inner, blur_.psf().radius()), whole);
  const Roi support = Intersect(Grown(inner, 2 * blur_.psf().radius()), whole);
  const float curvature = lambda * StructurePrior::kCurvatureMax;
  for (int iteration = 0; iteration < iterations; ++iteration) {
    const float momentum = NextMomentum();
    for (int y = support.y0; y < support.y1; ++y) {
      const float* now = buffer->scene.row(y);
      const float* before = buffer->previous.row(y);
      float* out = extrapolated_.row(y);
      std::copy(now + support.x0, now + support.x1, out + support.x0);
      if (y < inner.y0 || y >= inner.y1) continue;
      for (int x = inner.x0; x < inner.x1; ++x) out[x] += momentum * (now[x] - before[x]);
    }
    blur_.Apply(extrapolated_, context, &residual_);
    for (int y = context.y0; y < context.y1; ++y) {
      const float* w = buffer->weight.row(y);
      const float* z = buffer->weighted.row(y);
      float* r = residual_.row(y);
      for (int x = context.x0; x < context.x1; ++x) r[x] = w[x] * r[x] - z[x];
    }
    blur_.ApplyAdjoint(residual_, inner, &gradient_);
    options_.prior.AddGradient(extrapolated_, inner, lambda, &gradient_);
    for (int y = inner.y0; y < inner.y1; ++y) {
      const float* g = gradient_.row(y);
      const float* majoriser = buffer->majoriser.row(y);
      const float* start = extrapolated_.row(y);
      float* now = buffer->scene.row(y);
      float* before = buffer->previous.row(y);
      for (int x = inner.x0; x < inner.x1; ++x) {
        before[x] = now[x];
        now[x] = start[x] - g[x] / (majoriser[x] + curvature + kCurvatureMin);
      }
    }
  }
}

}  // namespace trem
