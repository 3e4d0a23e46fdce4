#include "worker/tre/automatic_regularisation.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "mosaic/base/parallel.h"
#include "worker/sensor/bicubic.h"
#include "worker/tre/information_update.h"
#include "worker/tre/update_kernels.h"

namespace trem {
namespace {

// Of the rule for lambda_0, fitted once to procedural and natural scenes (docs/BENCHMARKS.md).
constexpr double kScale = 0.07;
constexpr double kHidden = 1.9;
constexpr double kDeltaPerDifference = 1.0;
// Without learning.
constexpr double kFixedScale = 0.0125 / 4.0;
constexpr float kFixedDelta = 4.0F;
// Standard deviation of log f before anything was predicted, and how much of what was learnt a probe keeps: scenes change.
constexpr double kLogFactorSigma = 0.7;
constexpr double kKept = 0.9;
constexpr double kLogFactorMax = 3.0;
constexpr double kLogStepMax = 0.4;
constexpr int kProbeIterations = 8;
constexpr int kProbesDense = 6;  // Frames at the start that all make a probe; later every third does.
constexpr int kProbeEvery = 3;
// A difference of scale below this part of sigma is noise: bounds lambda on ground without any texture.
constexpr double kScaleMin = 0.1;
constexpr float kSeenMin = 0.75F;
constexpr int kManyRows = 300;
constexpr double kHuberSigmas = 3.0;

// Energies of other kinds weigh a scene of a given scale otherwise: the ratio of their sums' curvatures.
double KindFactor(StructurePriorKind kind) {
  switch (kind) {
    case StructurePriorKind::kHuberTv:
      return 1.0;
    case StructurePriorKind::kMembrane:
      return 0.5;
    case StructurePriorKind::kLaplacian:
      return 0.1;
    case StructurePriorKind::kBilateralTv:
      return 0.3;
  }
  return 1.0;
}

struct Texture {
  double mean = 0.0;    // Mean absolute difference of neighbouring cells, grey levels.
  double rms = 0.0;     // Root mean square of it: larger beside the mean, the more the contrast is that of few edges.
  double frames = 1.0;  // Mean number of frames that have seen a cell.
};

// Of the cells that were seen, over every third row, of many rows every sixth.
Texture TextureOf(const Roi& inner, const SceneBuffer& buffer) {
  TextureSums sum;
  const int step = inner.height() < kManyRows ? 3 : 6;
  for (int y = inner.y0; y + 1 < inner.y1; y += step) {
    const TextureSums row = SumTexture(buffer.scene.row(y) + inner.x0, buffer.scene.row(y + 1) + inner.x0, buffer.seen.row(y) + inner.x0,
                                       kSeenMin, std::max(inner.width() - 1, 0));
    sum.size += row.size;
    sum.squares += row.squares;
    sum.seen += row.seen;
    sum.count += row.count;
  }
  if (sum.count == 0.0) return {};
  return {sum.size / (2.0 * sum.count), std::sqrt(sum.squares / (2.0 * sum.count)), std::max(sum.seen / sum.count, 1.0)};
}

// The pixels of `roi` (0, 0 its corner) that may fall on `cells`: all of them for views that are not affine.
Roi PixelsOver(const Roi& cells, const PlanarMap& scene_from_sensor, const Roi& roi) {
  const Roi whole{0, 0, roi.width(), roi.height()};
  if (!scene_from_sensor.IsAffine()) return whole;
  const PlanarMap sensor_from_scene = scene_from_sensor.Inverse();
  Eigen::Vector2d low = Eigen::Vector2d::Constant(1e9);
  Eigen::Vector2d high = -low;
  for (const int x : {cells.x0, cells.x1}) {
    for (const int y : {cells.y0, cells.y1}) {
      const Eigen::Vector2d pixel = sensor_from_scene * Eigen::Vector2d(x, y);
      low = low.cwiseMin(pixel).cwiseMax(-1e9);
      high = high.cwiseMax(pixel).cwiseMin(1e9);
    }
  }
  const auto floor = [](double at) { return static_cast<int>(std::floor(at)); };
  return Intersect(whole, {floor(low.x()) - roi.x0, floor(low.y()) - roi.y0, floor(high.x()) - roi.x0 + 2, floor(high.y()) - roi.y0 + 2});
}

void Crop(const Image<float>& image, const Roi& roi, Image<float>* crop) {
  if (crop->width() != roi.width() || crop->height() != roi.height()) *crop = Image<float>(roi.width(), roi.height());
  for (int y = 0; y < roi.height(); ++y) std::copy(image.row(roi.y0 + y) + roi.x0, image.row(roi.y0 + y) + roi.x1, crop->row(y));
}

}  // namespace

AutomaticRegularisation::AutomaticRegularisation(const SeparablePsf& psf, StructurePriorKind kind, int ratio, bool learn, int threads)
    : kind_(kind),
      ratio_(ratio),
      learn_(learn),
      threads_(threads),
      trials_{Trial(psf), Trial(psf)},
      information_(1.0 / (kLogFactorSigma * kLogFactorSigma)) {}

StructureWeight AutomaticRegularisation::Weight(const Roi& region, const SceneBuffer& buffer, double noise_sigma) const {
  const Texture texture = TextureOf(buffer.InBuffer(region), buffer);
  if (!learn_) return {static_cast<float>(kFixedScale * noise_sigma * noise_sigma * (1.0 + 0.03 * texture.frames)), kFixedDelta};
  const double mean = std::max(texture.mean, kScaleMin * noise_sigma);
  const double scale = std::sqrt(mean * std::max(texture.rms, mean));
  const double variance = noise_sigma * noise_sigma;
  const double hidden = kHidden * scale * noise_sigma * 2.0 / (1.0 + texture.frames);
  StructureWeight weight;
  weight.lambda = static_cast<float>(std::exp(log_factor_) * KindFactor(kind_) * kScale * variance / (scale * scale + hidden));
  weight.delta = static_cast<float>(kDeltaPerDifference * mean * (1.0 + 1.0 / texture.frames));
  return weight;
}

void AutomaticRegularisation::Trial::Run(const SceneBuffer& buffer, const Roi& inner, const Roi& extent, const StructurePrior& prior,
                                         float lambda) {
  const Roi crop = buffer.InBuffer(extent);
  tile.extent = extent;
  Crop(buffer.scene, crop, &tile.scene);
  tile.previous = tile.scene;
  Crop(buffer.weight, crop, &tile.weight);
  Crop(buffer.weighted, crop, &tile.weighted);
  Crop(buffer.majoriser, crop, &tile.majoriser);
  tile.counted = buffer.counted;
  Crop(buffer.prediction, crop, &tile.prediction);
  update.set_prior(prior);
  update.Restart();
  update.Iterate(inner, kProbeIterations, lambda, &tile);
}

void AutomaticRegularisation::MakeProbe(const Roi& region, const SceneBuffer& buffer, double noise_sigma) {
  probe_.reset();
  if (!learn_) return;
  const int turn = probe_count_++;
  if (turn >= kProbesDense && turn % kProbeEvery != 0) return;
  // Half the ROI's side at first, when there is most to learn, then a third, at most 32 sensor pixels; at places that a golden ratio
  // sequence spreads evenly over what the ROI will see again.
  const int rim = radius() + 3 * ratio_;
  const int reach = std::min(region.width(), region.height());
  const int side = turn < kProbesDense ? std::clamp(reach / 2, 10 * ratio_, 64 * ratio_) : std::clamp(reach / 3, 10 * ratio_, 32 * ratio_);
  const int room_x = region.width() - 2 * rim - side;
  const int room_y = region.height() - 2 * rim - side;
  if (room_x <= 0 || room_y <= 0) return;
  const auto fraction = [turn](double step) { return std::fmod(0.5 + step * turn, 1.0); };
  const int x0 = region.x0 + rim + static_cast<int>(fraction(0.7548776662) * room_x);
  const int y0 = region.y0 + rim + static_cast<int>(fraction(0.5698402910) * room_y);
  const Roi inner{x0, y0, x0 + side, y0 + side};
  const int margin = 2 * radius() + 2;
  const Roi extent = Intersect({inner.x0 - margin, inner.y0 - margin, inner.x1 + margin, inner.y1 + margin}, buffer.extent);
  if (!extent.Contains(inner)) return;
  const StructureWeight middle = Weight(region, buffer, noise_sigma);
  ForEachIndex(threads_, 2, [&](int which, int) {
    trials_[static_cast<std::size_t>(which)].Run(buffer, inner, extent, {kind_, middle.delta}, (which == 0 ? 0.5F : 2.0F) * middle.lambda);
  });
  probe_ = Probe{inner, extent};
}

void AutomaticRegularisation::Learn(const Observation& observation, const View& view) {
  if (!probe_) return;
  const Probe& probe = *probe_;
  const double limit = kHuberSigmas * observation.noise_sigma;
  const double gain = view.gain;
  // Cells whose bicubic support the probe's inner part does not hold are left out.
  const Roi held{probe.inner.x0 + 2, probe.inner.y0 + 2, probe.inner.x1 - 2, probe.inner.y1 - 2};
  double score = 0.0;
  double curvature = 0.0;
  const Roi pixels = PixelsOver(held, view.scene_from_sensor, observation.roi);
  for (int v = pixels.y0; v < pixels.y1; ++v) {
    for (int u = pixels.x0; u < pixels.x1; ++u) {
      const float value = observation.roi_pixels->at(u, v);
      const float trust = observation.weight(u, v);
      if (std::isnan(value) || !(trust > 0.0F)) continue;
      const Eigen::Vector2d cell = view.scene_from_sensor * Eigen::Vector2d(observation.roi.x0 + u, observation.roi.y0 + v);
      if (!(cell.x() >= held.x0 && cell.x() < held.x1 && cell.y() >= held.y0 && cell.y() < held.y1)) continue;
      const double x = cell.x() - probe.extent.x0;
      const double y = cell.y() - probe.extent.y0;
      const double less = SampleCubic(trials_[0].tile.prediction, x, y);
      const double more = SampleCubic(trials_[1].tile.prediction, x, y);
      const double slope = gain * (more - less) / (2.0 * std::numbers::ln2);
      const double residual = std::clamp(value - view.offset - gain * 0.5 * (more + less), -limit, limit);
      score += trust * residual * slope;
      curvature += trust * slope * slope;
    }
  }
  const double variance = observation.noise_sigma * observation.noise_sigma;
  information_ = kKept * information_ + curvature / variance;
  const double step = score / variance / information_;
  log_factor_ = std::clamp(log_factor_ + std::clamp(step, -kLogStepMax, kLogStepMax), -kLogFactorMax, kLogFactorMax);
  probe_.reset();
}

}  // namespace trem
