#include "worker/tre/held_out_weight.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>
#include <vector>

#include "worker/sensor/bicubic.h"
#include "worker/tre/emitted_band.h"

namespace trem {
namespace {

// Standard deviation of log lambda about the start.
constexpr double kSigma = 0.7;
// Solutions at most, a factor of two apart.
constexpr int kReach = 5;
constexpr int kIterations = 60;
// Tiles along each axis and their side at most; what their borders, where nothing pulls from outside, may be wrong by [cells].
constexpr int kTilesAcross = 3;
constexpr int kTileSide = 96;
constexpr int kRim = 10;
constexpr double kHuberSigmas = 3.0;
// Cells seen by fewer of the other frames say nothing.
constexpr float kSeenMin = 1.5F;

struct Score {
  double value = 0.0;
  double variance = 0.0;
};

// sum of w r q(x) and its variance by the noise.
void AddFrame(const KeptFrame& frame, double noise_sigma, const SceneBuffer& tile, const Image<float>& mean, const Image<float>& field,
              Score* score) {
  const double limit = kHuberSigmas * noise_sigma;
  const double gain = frame.view.gain;
  for (int v = 0; v < frame.roi.height(); ++v) {
    for (int u = 0; u < frame.roi.width(); ++u) {
      const float value = frame.pixels.at(u, v);
      const float trust = frame.weights.empty() ? 1.0F : frame.weights.at(u, v);
      if (std::isnan(value) || !(trust > 0.0F)) continue;
      const Eigen::Vector2d cell = frame.view.scene_from_sensor * Eigen::Vector2d(frame.roi.x0 + u, frame.roi.y0 + v);
      const double x = cell.x() - tile.extent.x0;
      const double y = cell.y() - tile.extent.y0;
      if (!(x >= kRim && y >= kRim && x < mean.width() - kRim && y < mean.height() - kRim)) continue;
      if (tile.seen.at(static_cast<int>(x + 0.5), static_cast<int>(y + 0.5)) < kSeenMin) continue;
      const double residual = std::clamp(value - frame.view.offset - gain * SampleCubic(mean, x, y), -limit, limit);
      const double q = gain * SampleCubic(field, x, y);
      score->value += trust * residual * q;
      score->variance += trust * noise_sigma * noise_sigma * q * q;
    }
  }
}

Image<float> Cropped(const Image<float>& image, const Roi& roi) {
  Image<float> crop(roi.width(), roi.height());
  for (int y = 0; y < roi.height(); ++y) std::copy_n(image.row(roi.y0 + y) + roi.x0, roi.width(), crop.row(y));
  return crop;
}

// Tiles all over the buffer with the samples of the frames that were not held out.
std::vector<SceneBuffer> MakeTiles(const SceneBuffer& buffer, const Accumulated& sums, int ratio, InformationUpdate* update) {
  const Roi& e = buffer.extent;
  const int width = std::min(kTileSide, e.width() / kTilesAcross);
  const int height = std::min(kTileSide, e.height() / kTilesAcross);
  std::vector<SceneBuffer> tiles;
  for (int j = 0; j < kTilesAcross; ++j) {
    for (int i = 0; i < kTilesAcross; ++i) {
      const int x0 = e.x0 + (2 * i + 1) * e.width() / (2 * kTilesAcross) - width / 2;
      const int y0 = e.y0 + (2 * j + 1) * e.height() / (2 * kTilesAcross) - height / 2;
      SceneBuffer tile({x0, y0, x0 + width, y0 + height});
      const Roi crop = buffer.InBuffer(tile.extent);
      tile.scene = Cropped(buffer.scene, crop);
      tile.weight = Cropped(sums.weight, crop);
      tile.weighted = Cropped(sums.weighted, crop);
      update->UpdateSeen(tile.extent, ratio, &tile);
      tiles.push_back(std::move(tile));
    }
  }
  return tiles;
}

// The scenes of successive k, and what the frames held out say between two of them.
class Search {
 public:
  Search(const KeptFrames& frames, const Accumulated& sums, const StructureWeight& start, int ratio, double noise_sigma,
         const SceneBuffer& buffer, InformationUpdate* update)
      : frames_(frames),
        held_(sums.held),
        start_(start),
        noise_sigma_(noise_sigma),
        update_(update),
        tiles_(MakeTiles(buffer, sums, ratio, update)) {}

  std::vector<Image<float>> Solve(int k) {
    ++solutions_;
    std::vector<Image<float>> scenes;
    for (SceneBuffer& tile : tiles_) {
      update_->Converge(tile.extent, kIterations, static_cast<float>(start_.lambda * std::exp2(k)), &tile);
      scenes.push_back(tile.scene);
    }
    return scenes;
  }

  Score Between(const std::vector<Image<float>>& less, const std::vector<Image<float>>& more) const {
    Score score;
    for (std::size_t t = 0; t < tiles_.size(); ++t) {
      SceneBuffer mean(tiles_[t].extent);
      Image<float> difference(mean.scene.width(), mean.scene.height());
      for (std::size_t i = 0; i < difference.pixels().size(); ++i) {
        difference.pixels()[i] = more[t].pixels()[i] - less[t].pixels()[i];
        mean.scene.pixels()[i] = 0.5F * (more[t].pixels()[i] + less[t].pixels()[i]);
      }
      update_->Predict(mean.extent, &mean);
      const Image<float> field = InEmittedBand(InEmittedBand(difference));
      for (const std::size_t k : held_) AddFrame(frames_.entry(k).frame, noise_sigma_, tiles_[t], mean.prediction, field, &score);
    }
    return score;
  }

  int solutions() const { return solutions_; }

 private:
  const KeptFrames& frames_;
  std::vector<std::size_t> held_;
  StructureWeight start_;
  double noise_sigma_;
  InformationUpdate* update_;
  std::vector<SceneBuffer> tiles_;
  int solutions_ = 0;
};

}  // namespace

HeldOutWeight FindHeldOutWeight(const KeptFrames& frames, const Accumulated& sums, const StructureWeight& start, int ratio,
                                double noise_sigma, const SceneBuffer& buffer, InformationUpdate* update) {
  Search search(frames, sums, start, ratio, noise_sigma, buffer, update);
  std::vector<Image<float>> before = search.Solve(0);
  std::vector<Image<float>> now = search.Solve(1);
  Score score = search.Between(before, now);
  const int direction = score.value > 0.0 ? 1 : -1;
  if (direction < 0) std::swap(before, now);  // `now` is always the outermost solution.
  double middle = 0.5;                        // k that `score` belongs to.
  double slope = 0.0;                         // Of the score over k.
  double zero = middle;
  for (int step = 1; step < kReach; ++step) {
    before = std::move(now);
    now = search.Solve(direction > 0 ? step + 1 : -step);
    const Score next = direction > 0 ? search.Between(before, now) : search.Between(now, before);
    slope = direction * (next.value - score.value);
    if (slope < 0.0) zero = middle - score.value / slope;
    if (next.value * score.value <= 0.0) break;
    score = next;
    middle += direction;
    zero = middle;
  }
  HeldOutWeight found;
  found.solutions = search.solutions();
  const double measured = zero * std::numbers::ln2;
  const double slope_of_log = slope / std::numbers::ln2;
  const double information = score.variance > 0.0 ? slope_of_log * slope_of_log / score.variance : 0.0;
  found.log_factor = measured * information / (information + 1.0 / (kSigma * kSigma));
  return found;
}

}  // namespace trem
