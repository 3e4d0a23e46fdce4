#include "worker/tre/kept_frames.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "mosaic/base/parallel.h"
#include "worker/sensor/bicubic.h"
#include "worker/tre/update_kernels.h"

namespace trem {
namespace {

// Rows of the scene that one thread accumulates.
constexpr int kBandRows = 64;
// Cells seen by fewer frames have nothing to be an outlier of; as in the splat.
constexpr float kKnownFrames = 1.5F;
// Part of the frames that is added up for good when they are too many.
constexpr std::size_t kEvictedPart = 4;
// Pixels of a frame that its residuals' spread is found from, about, and at least; and how far it may move the frame's weight.
constexpr double kSpreadSamples = 2500.0;
constexpr std::size_t kSpreadSamplesMin = 200;
constexpr double kFrameWeightMax = 4.0;

std::size_t BytesOf(const KeptFrame& frame) { return 4 * (frame.pixels.pixels().size() + frame.weights.pixels().size()); }

// Where pixels of a frame's row lie in the buffer.
struct RowPlaces {
  RowPlaces(const PlanarMap& map, const Roi& roi, int v, const Eigen::Vector2d& origin) {
    const Eigen::Vector2d pixel(roi.x0, roi.y0 + v);
    depth = map.Depth(pixel);
    d_depth = map.perspective.x();
    first = map.linear * pixel + map.offset - depth * origin;
    step = map.linear.col(0) - d_depth * origin;
  }
  // False behind the horizon.
  bool At(int u, double* x, double* y) const {
    const double d = depth + u * d_depth;
    if (!(d > 0.0)) return false;
    *x = (first.x() + u * step.x()) / d;
    *y = (first.y() + u * step.y()) / d;
    return true;
  }
  // False when no pixel of [0, count) lies within `reach` of rows [begin, end). A row is a straight line in the scene.
  bool Meets(int count, int begin, int end, double reach) const {
    double x = 0.0;
    double y0 = 0.0;
    double y1 = 0.0;
    if (!At(0, &x, &y0) || !At(count - 1, &x, &y1)) return true;
    return std::max(y0, y1) >= begin - reach && std::min(y0, y1) <= end + reach;
  }

  double depth = 1.0;
  double d_depth = 0.0;
  Eigen::Vector2d first;
  Eigen::Vector2d step;
};

// W and C' w r of one frame on rows [band.y0, band.y1) of the buffer.
void AddBand(const KeptFrame& frame, float frame_weight, float limit, const SceneBuffer& buffer, const Roi& band, Image<float>* weight,
             Image<float>* pull) {
  const float gain = static_cast<float>(frame.view.gain);
  const float offset = static_cast<float>(frame.view.offset);
  const Eigen::Vector2d origin(buffer.extent.x0, buffer.extent.y0);
  const Image<float>& prediction = buffer.prediction;
  for (int v = 0; v < frame.roi.height(); ++v) {
    const RowPlaces places(frame.view.scene_from_sensor, frame.roi, v, origin);
    if (!places.Meets(frame.roi.width(), band.y0, band.y1, 3.0)) continue;
    const float* pixels = frame.pixels.row(v);
    const float* trusts = frame.weights.empty() ? nullptr : frame.weights.row(v);
    for (int u = 0; u < frame.roi.width(); ++u) {
      const float trust = trusts != nullptr ? trusts[u] : 1.0F;
      double x = 0.0;
      double y = 0.0;
      if (std::isnan(pixels[u]) || !(trust > 0.0F) || !places.At(u, &x, &y) || !CubicSupported(prediction, x, y)) continue;
      const int ix = static_cast<int>(x);
      const int iy = static_cast<int>(y);
      if (iy + 2 < band.y0 || iy - 1 >= band.y1) continue;
      const std::array<float, 4> wx = CubicWeights(static_cast<float>(x - ix));
      const std::array<float, 4> wy = CubicWeights(static_cast<float>(y - iy));
      float predicted = 0.0F;
      for (int j = 0; j < 4; ++j) {
        const float* p = prediction.row(iy - 1 + j) + ix - 1;
        predicted += wy[static_cast<std::size_t>(j)] * (wx[0] * p[0] + wx[1] * p[1] + wx[2] * p[2] + wx[3] * p[3]);
      }
      const float difference = (pixels[u] - offset) / gain - predicted;
      const float size = std::abs(gain * difference);
      const int cx = static_cast<int>(x + 0.5);
      const int cy = static_cast<int>(y + 0.5);
      const float robust = buffer.seen.at(cx, cy) >= kKnownFrames && size > limit ? limit / size : 1.0F;
      const float w = trust * robust * frame_weight * gain * gain;
      if (cy >= band.y0 && cy < band.y1) weight->at(cx, cy) += w;
      for (int j = 0; j < 4; ++j) {
        const int row = iy - 1 + j;
        if (row < band.y0 || row >= band.y1) continue;
        float* p = pull->row(row) + ix - 1;
        const float value = w * difference * wy[static_cast<std::size_t>(j)];
        for (int i = 0; i < 4; ++i) p[i] += value * wx[static_cast<std::size_t>(i)];
      }
    }
  }
}

// Robust standard deviation of a frame's residuals; 0 when too few are known.
double ResidualSpread(const KeptFrame& frame, const SceneBuffer& buffer) {
  const Eigen::Vector2d origin(buffer.extent.x0, buffer.extent.y0);
  const Image<float>& prediction = buffer.prediction;
  const int step = std::max(static_cast<int>(std::sqrt(static_cast<double>(frame.roi.area()) / kSpreadSamples)), 1);
  std::vector<float> sizes;
  for (int v = step / 2; v < frame.roi.height(); v += step) {
    const RowPlaces places(frame.view.scene_from_sensor, frame.roi, v, origin);
    for (int u = step / 2; u < frame.roi.width(); u += step) {
      double x = 0.0;
      double y = 0.0;
      const float value = frame.pixels.at(u, v);
      if (std::isnan(value) || (!frame.weights.empty() && !(frame.weights.at(u, v) > 0.0F))) continue;
      if (!places.At(u, &x, &y) || !CubicSupported(prediction, x, y)) continue;
      if (buffer.seen.at(static_cast<int>(x + 0.5), static_cast<int>(y + 0.5)) < kKnownFrames) continue;
      sizes.push_back(static_cast<float>(std::abs(value - frame.view.offset - frame.view.gain * SampleCubic(prediction, x, y))));
    }
  }
  if (sizes.size() < kSpreadSamplesMin) return 0.0;
  const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
  std::nth_element(sizes.begin(), middle, sizes.end());
  return *middle;
}

void Fade(const Roi& where, double factor, Image<float>* image) {
  if (factor >= 1.0 || image->empty()) return;
  for (int y = where.y0; y < where.y1; ++y) ScaleRow(static_cast<float>(factor), where.width(), image->row(y) + where.x0);
}

// a += sign * b * c, cell by cell.
void AddProduct(const Image<float>& b, const Image<float>& c, float sign, Image<float>* a) {
  for (std::size_t k = 0; k < a->pixels().size(); ++k) a->pixels()[k] += sign * b.pixels()[k] * c.pixels()[k];
}

Image<float> Moved(const Image<float>& image, const Roi& from, const Roi& to) {
  Image<float> moved(to.width(), to.height());
  const Roi kept = Intersect(from, to);
  for (int y = kept.y0; y < kept.y1; ++y) {
    const float* source = image.row(y - from.y0) + (kept.x0 - from.x0);
    std::copy(source, source + kept.width(), moved.row(y - to.y0) + (kept.x0 - to.x0));
  }
  return moved;
}

}  // namespace

void KeptFrames::Add(KeptFrame frame, const Roi& region, double forgetting, const SceneBuffer& buffer) {
  bytes_ += BytesOf(frame);
  frames_.push_back({std::move(frame), region, forgetting});
  if (bytes_ > bytes_max_) EvictBeyondBound(buffer);
}

void KeptFrames::Revise(int frame_index, const View& view) {
  for (Entry& entry : frames_) {
    if (entry.frame.frame_index == frame_index) entry.frame.view = view;
  }
}

void KeptFrames::Forget(const Roi& cells) {
  for (Entry& entry : frames_) {
    if (Intersect(entry.region, cells).empty()) continue;
    KeptFrame& frame = entry.frame;
    for (int v = 0; v < frame.roi.height(); ++v) {
      const RowPlaces places(frame.view.scene_from_sensor, frame.roi, v, Eigen::Vector2d::Zero());
      if (!places.Meets(frame.roi.width(), cells.y0, cells.y1, 1.0)) continue;
      for (int u = 0; u < frame.roi.width(); ++u) {
        double x = 0.0;
        double y = 0.0;
        if (!places.At(u, &x, &y) || !cells.Contains(static_cast<int>(std::lround(x)), static_cast<int>(std::lround(y)))) continue;
        if (frame.weights.empty()) {
          frame.weights = Image<float>(frame.roi.width(), frame.roi.height(), 1.0F);
          bytes_ += 4 * frame.weights.pixels().size();
        }
        frame.weights.at(u, v) = 0.0F;
      }
    }
  }
  if (settled_weight_.empty()) return;
  const Roi gone = Intersect(settled_extent_, cells);
  for (int y = gone.y0; y < gone.y1; ++y) {
    for (Image<float>* plane : {&settled_weight_, &settled_weighted_}) {
      std::fill_n(plane->row(y - settled_extent_.y0) + (gone.x0 - settled_extent_.x0), std::max(gone.width(), 0), 0.0F);
    }
  }
}

void KeptFrames::MoveTo(const Roi& extent) {
  if (!settled_weight_.empty()) {
    settled_weight_ = Moved(settled_weight_, settled_extent_, extent);
    settled_weighted_ = Moved(settled_weighted_, settled_extent_, extent);
    settled_extent_ = extent;
  }
  std::erase_if(frames_, [&](const Entry& entry) {
    const bool gone = Intersect(entry.region, extent).empty();
    if (gone) bytes_ -= BytesOf(entry.frame);
    return gone;
  });
}

void KeptFrames::EvictBeyondBound(const SceneBuffer& buffer) {
  const std::size_t count = std::max(frames_.size() / kEvictedPart, std::size_t{1});
  KeptFrames evicted(huber_sigmas_, threads_, bytes_max_);
  evicted.settled_extent_ = settled_extent_;
  evicted.settled_weight_ = std::move(settled_weight_);
  evicted.settled_weighted_ = std::move(settled_weighted_);
  for (std::size_t k = 0; k < count; ++k) {
    bytes_ -= BytesOf(frames_.front().frame);
    evicted.frames_.push_back(std::move(frames_.front()));
    frames_.pop_front();
  }
  Accumulated sums = evicted.Accumulate(buffer, 0);
  settled_extent_ = buffer.extent;
  settled_weight_ = std::move(sums.weight);
  settled_weighted_ = std::move(sums.weighted);
}

std::vector<float> KeptFrames::FrameWeights(const SceneBuffer& buffer) const {
  std::vector<double> spreads(frames_.size());
  ForEachIndex(threads_, static_cast<int>(frames_.size()), [&](int k, int) {
    spreads[static_cast<std::size_t>(k)] = ResidualSpread(frames_[static_cast<std::size_t>(k)].frame, buffer);
  });
  std::vector<double> known = spreads;
  std::erase(known, 0.0);
  std::vector<float> weights(frames_.size(), 1.0F);
  if (known.empty()) return weights;
  std::nth_element(known.begin(), known.begin() + static_cast<std::ptrdiff_t>(known.size() / 2), known.end());
  const double usual = known[known.size() / 2];
  for (std::size_t k = 0; k < weights.size(); ++k) {
    if (spreads[k] > 0.0)
      weights[k] = static_cast<float>(std::clamp(std::pow(usual / spreads[k], 2), 1.0 / kFrameWeightMax, kFrameWeightMax));
  }
  return weights;
}

Accumulated KeptFrames::Accumulate(const SceneBuffer& buffer, std::size_t hold_every) const {
  const int width = buffer.scene.width();
  const int height = buffer.scene.height();
  Accumulated sums;
  Image<float> pull(width, height);
  if (settled_weight_.empty()) {
    sums.weight = pull;
  } else {
    TREM_CHECK(settled_extent_ == buffer.extent);
    sums.weight = settled_weight_;
    pull = settled_weighted_;
    AddProduct(sums.weight, buffer.prediction, -1.0F, &pull);
  }
  Image<float> held_pull;
  if (hold_every > 0) sums.held_weight = held_pull = Image<float>(width, height);
  const auto is_held = [hold_every](std::size_t k) { return hold_every > 0 && k % hold_every == hold_every / 2; };
  const std::vector<float> weights = FrameWeights(buffer);
  ForEachIndex(threads_, (height + kBandRows - 1) / kBandRows, [&](int index, int) {
    const Roi band{0, index * kBandRows, width, std::min((index + 1) * kBandRows, height)};
    for (std::size_t k = 0; k < frames_.size(); ++k) {
      const Entry& entry = frames_[k];
      const Roi faded = Intersect(buffer.InBuffer(entry.region), band);
      for (Image<float>* plane : {&sums.weight, &pull, &sums.held_weight, &held_pull}) Fade(faded, entry.forgetting, plane);
      const float limit = static_cast<float>(huber_sigmas_ * entry.frame.noise_sigma);
      AddBand(entry.frame, weights[k], limit, buffer, band, is_held(k) ? &sums.held_weight : &sums.weight, is_held(k) ? &held_pull : &pull);
    }
  });
  AddProduct(sums.weight, buffer.prediction, 1.0F, &pull);
  sums.weighted = std::move(pull);
  if (hold_every == 0) return sums;
  AddProduct(sums.held_weight, buffer.prediction, 1.0F, &held_pull);
  sums.held_weighted = std::move(held_pull);
  for (std::size_t k = 0; k < frames_.size(); ++k) {
    if (is_held(k)) sums.held.push_back(k);
  }
  return sums;
}

}  // namespace trem
