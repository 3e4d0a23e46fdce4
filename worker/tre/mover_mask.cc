#include "worker/tre/mover_mask.h"

#include <algorithm>
#include <cmath>

#include "mosaic/base/parallel.h"
#include "worker/tre/view_row.h"

namespace trem {
namespace {

// A pixel's squared residual counts up to this many variances, so that one pixel cannot speak for nine.
constexpr float kExcessMax = 16.0F;
// Mean of min(excess, kSmallExcess) when noise alone is at work: E min(z^2, 3) of a Gaussian z.
constexpr float kSmallExcess = 3.0F;
constexpr float kSmallExcessMean = 0.84F;
// Mean over 3 x 3 from which a pixel is masked (4 of 9 at the cap), and over ground masked a frame ago.
constexpr float kScoreHigh = 7.0F;
constexpr float kScoreLow = 3.0F;
// Part of the ROI beyond which it is the scene, or its registration, that is wrong.
constexpr double kPartMax = 0.35;
// Votes to outvote a block: as many as frames had seen it, within these.
constexpr float kVotesMin = 8.0F;
constexpr float kVotesMax = 24.0F;
// Rows that one thread takes at a time.
constexpr int kBandRows = 64;
// Votes agree when they differ by less than this part, or this many noise sigmas.
constexpr float kVotePart = 0.35F;
constexpr float kVoteSigmas = 4.0F;

int FloorDivide(int a, int b) { return a >= 0 ? a / b : -((b - 1 - a) / b); }

template <typename T>
void FitSize(const Image<float>& like, Image<T>* image) {
  if (image->width() != like.width() || image->height() != like.height()) *image = Image<T>(like.width(), like.height());
}

// Calls visit(u, v, x, y) for every pixel of the ROI with its place in the scene plane [cells].
template <typename Visit>
void ForEachPixel(const View& view, const Roi& roi, const Visit& visit) {
  for (int v = 0; v < roi.height(); ++v) {
    const ViewRow row(view.scene_from_sensor, roi, v);
    for (int u = 0; u < roi.width(); ++u) {
      float x = 0.0F;
      float y = 0.0F;
      row.At(u, &x, &y);
      visit(u, v, x, y);
    }
  }
}

}  // namespace

// The blocks that the ROI covers at `view` are in memory; what it has left is forgotten.
void MoverMask::Cover(const View& view, const Roi& roi) {
  Eigen::Vector2d low = Eigen::Vector2d::Constant(1e9);
  Eigen::Vector2d high = -low;
  for (const int x : {roi.x0, roi.x1 - 1}) {
    for (const int y : {roi.y0, roi.y1 - 1}) {
      const Eigen::Vector2d cell = view.scene_from_sensor * Eigen::Vector2d(x, y) / ratio_;
      low = low.cwiseMin(cell);
      high = high.cwiseMax(cell);
    }
  }
  const Roi needed{static_cast<int>(std::floor(low.x())) - 1, static_cast<int>(std::floor(low.y())) - 1,
                   static_cast<int>(std::ceil(high.x())) + 2, static_cast<int>(std::ceil(high.y())) + 2};
  if (extent_.Contains(needed) && !blocks_.empty()) return;
  const Roi grown{needed.x0 - 16, needed.y0 - 16, needed.x1 + 16, needed.y1 + 16};
  Image<State> moved(grown.width(), grown.height());
  const Roi kept = Intersect(grown, extent_);
  for (int y = kept.y0; y < kept.y1; ++y) {
    for (int x = kept.x0; x < kept.x1; ++x) moved.at(x - grown.x0, y - grown.y0) = blocks_.at(x - extent_.x0, y - extent_.y0);
  }
  blocks_ = std::move(moved);
  extent_ = grown;
}

int MoverMask::IndexAt(float cell_x, float cell_y) const {
  const int x = FloorDivide(static_cast<int>(std::floor(cell_x + 0.5F)), ratio_);
  const int y = FloorDivide(static_cast<int>(std::floor(cell_y + 0.5F)), ratio_);
  return extent_.Contains(x, y) ? (y - extent_.y0) * extent_.width() + x - extent_.x0 : -1;
}

bool MoverMask::Hide(const View& view, const Roi& roi, Image<float>* weights) const {
  if (!any_hidden_) return false;
  if (weights->empty()) *weights = Image<float>(roi.width(), roi.height(), 1.0F);
  ForEachPixel(view, roi, [&](int u, int v, float x, float y) {
    const int index = IndexAt(x, y);
    if (index >= 0 && blocks_.pixels()[static_cast<std::size_t>(index)].hidden != 0) weights->at(u, v) = 0.0F;
  });
  return true;
}

bool MoverMask::IsOutvoted(const Eigen::Vector2d& cell) const {
  const int index = IndexAt(static_cast<float>(cell.x()), static_cast<float>(cell.y()));
  return index >= 0 && !outvoted_.empty() && blocks_.pixels()[static_cast<std::size_t>(index)].anew == stamp_;
}

void MoverMask::SumRow(const FrameResidual& residual, int v) {
  const int width = residual.value.width();
  const float* value = residual.value.row(v);
  const float* variance = residual.variance.row(v);
  std::vector<float> excess(static_cast<std::size_t>(width) + 2, 0.0F);
  std::vector<float> known(excess.size(), 0.0F);
  for (int u = 0; u < width; ++u) {
    const float squared = value[u] * value[u];
    const bool usable = squared < 1e18F;  // Not when NaN.
    excess[static_cast<std::size_t>(u) + 1] = usable ? std::min(squared / variance[u], kExcessMax) : 0.0F;
    known[static_cast<std::size_t>(u) + 1] = usable ? 1.0F : 0.0F;
  }
  RowSum& sum = row_sums_[static_cast<std::size_t>(v)];
  sum = {};
  for (int u = 1; u <= width; ++u) {
    sum.small += std::min(excess[static_cast<std::size_t>(u)], kSmallExcess);
    sum.pixels += known[static_cast<std::size_t>(u)];
  }
  float* sums = excess_.row(v);
  float* counts = known_.row(v);
  for (int u = 0; u < width; ++u) {
    const float* e = excess.data() + u;
    const float* k = known.data() + u;
    sums[u] = e[0] + e[1] + e[2];
    counts[u] = k[0] + k[1] + k[2];
  }
}

void MoverMask::ScoreRow(int v, float misfit) {
  const int above = std::max(v - 1, 0);
  const int below = std::min(v + 1, score_.height() - 1);
  float* score = score_.row(v);
  for (int u = 0; u < score_.width(); ++u) {
    const float sum = excess_.at(u, v) + (above < v ? excess_.at(u, above) : 0.0F) + (below > v ? excess_.at(u, below) : 0.0F);
    const float count = known_.at(u, v) + (above < v ? known_.at(u, above) : 0.0F) + (below > v ? known_.at(u, below) : 0.0F);
    // Of few neighbours nothing can be said.
    score[u] = count >= 4.0F ? sum / count / misfit : 0.0F;
  }
}

void MoverMask::SumUp(const FrameResidual& residual, int threads) {
  const int height = residual.value.height();
  FitSize(residual.value, &excess_);
  FitSize(residual.value, &known_);
  FitSize(residual.value, &score_);
  row_sums_.resize(static_cast<std::size_t>(height));
  const auto for_rows = [&](const auto& body) {
    ForEachIndex(threads, (height + kBandRows - 1) / kBandRows, [&](int band, int) {
      for (int v = band * kBandRows; v < std::min((band + 1) * kBandRows, height); ++v) body(v);
    });
  };
  // Sums along rows first.
  for_rows([&](int v) { SumRow(residual, v); });
  double small = 0.0;
  double pixels = 0.0;
  for (const RowSum& sum : row_sums_) {
    small += sum.small;
    pixels += sum.pixels;
  }
  // Where the model is off all over (smear, parallax, an underestimated noise), more is needed to stand out.
  const float misfit = pixels > 0.0 ? static_cast<float>(small / pixels) / kSmallExcessMean : 1.0F;
  for_rows([&](int v) { ScoreRow(v, std::max(misfit, 1.0F)); });
}

void MoverMask::Flag(const View& view, const Roi& roi) {
  FitSize(score_, &flagged_);
  flagged_count_ = 0;
  if (!any_hidden_) {
    for (std::size_t i = 0; i < flagged_.pixels().size(); ++i) {
      const bool high = score_.pixels()[i] > kScoreHigh;
      flagged_.pixels()[i] = high ? 1 : 0;
      flagged_count_ += high ? 1 : 0;
    }
    return;
  }
  ForEachPixel(view, roi, [&](int u, int v, float x, float y) {
    const float score = score_.at(u, v);
    bool flagged = score > kScoreHigh;
    if (!flagged && score > kScoreLow) {
      const int index = IndexAt(x, y);
      flagged = index >= 0 && blocks_.pixels()[static_cast<std::size_t>(index)].hidden != 0;
    }
    flagged_.at(u, v) = flagged ? 1 : 0;
    flagged_count_ += flagged ? 1 : 0;
  });
}

void MoverMask::Vote(const FrameResidual& residual, const View& view, const Roi& roi, double noise_sigma) {
  const float inverse_gain = static_cast<float>(1.0 / view.gain);
  const float tolerance = kVoteSigmas * static_cast<float>(noise_sigma);
  stamp_ = static_cast<unsigned char>(stamp_ == 255 ? 1 : stamp_ + 1);
  ForEachPixel(view, roi, [&](int u, int v, float x, float y) {
    const float value = residual.value.at(u, v);
    if (!(std::abs(value) < 1e9F)) return;
    const int index = IndexAt(x, y);
    if (index < 0) return;
    State* const state = &blocks_.pixels()[static_cast<std::size_t>(index)];
    if (state->stamp == stamp_) return;
    state->stamp = stamp_;
    if (flagged_.at(u, v) == 0) {
      state->count = 0;
      return;
    }
    const float vote = value * inverse_gain;
    if (state->count == 0 || std::abs(vote - state->mean) > std::max(kVotePart * std::abs(state->mean), tolerance)) {
      state->mean = vote;
      state->count = 1;
      return;
    }
    state->count = static_cast<unsigned char>(std::min(state->count + 1, 255));
    state->mean += (vote - state->mean) / static_cast<float>(state->count);
    const float needed = std::clamp(residual.frames_seen.at(u, v), kVotesMin, kVotesMax);
    if (static_cast<float>(state->count) <= needed) return;
    outvoted_.push_back({index % extent_.width() + extent_.x0, index / extent_.width() + extent_.y0});
  });
  // The blocks beside them go with them: samples there are mixed with the old thing by the point spread, and beside a new one they would
  // force the scene to overshoot.
  const std::size_t sure = outvoted_.size();
  for (std::size_t i = 0; i < sure; ++i) {
    for (int y = outvoted_[i].y - 1; y <= outvoted_[i].y + 1; ++y) {
      for (int x = outvoted_[i].x - 1; x <= outvoted_[i].x + 1; ++x) {
        if (!extent_.Contains(x, y)) continue;
        State& state = blocks_.at(x - extent_.x0, y - extent_.y0);
        state.count = 0;
        if (state.anew == stamp_) continue;
        const bool itself = x == outvoted_[i].x && y == outvoted_[i].y;
        if (!itself) outvoted_.push_back({x, y});
        state.anew = stamp_;
      }
    }
  }
}

void MoverMask::Dilate() {
  const int width = flagged_.width();
  const int height = flagged_.height();
  FitSize(score_, &mask_);
  std::fill(mask_.pixels().begin(), mask_.pixels().end(), static_cast<unsigned char>(0));
  masked_count_ = 0;
  if (flagged_count_ == 0) return;
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      if (flagged_.at(u, v) == 0) continue;
      for (int j = std::max(v - 1, 0); j <= std::min(v + 1, height - 1); ++j) {
        for (int i = std::max(u - 1, 0); i <= std::min(u + 1, width - 1); ++i) mask_.at(i, j) = 1;
      }
    }
  }
  for (const unsigned char masked : mask_.pixels()) masked_count_ += masked;
}

void MoverMask::SpreadHidden() {
  if (!any_hidden_ && flagged_count_ == 0) return;
  any_hidden_ = false;
  for (State& state : blocks_.pixels()) state.hidden = 0;
  for (int y = 1; y + 1 < extent_.height(); ++y) {
    for (int x = 1; x + 1 < extent_.width(); ++x) {
      if (blocks_.at(x, y).count == 0) continue;
      any_hidden_ = true;
      for (int j = y - 1; j <= y + 1; ++j) {
        for (int i = x - 1; i <= x + 1; ++i) blocks_.at(i, j).hidden = 1;
      }
    }
  }
}

void MoverMask::Judge(const FrameResidual& residual, const View& view, const Roi& roi, double noise_sigma, int threads) {
  outvoted_.clear();
  Cover(view, roi);
  SumUp(residual, threads);
  Flag(view, roi);
  if (static_cast<double>(flagged_count_) > kPartMax * static_cast<double>(roi.area())) {
    std::fill(flagged_.pixels().begin(), flagged_.pixels().end(), static_cast<unsigned char>(0));
    flagged_count_ = 0;
  } else if (flagged_count_ > 0 || any_hidden_) {
    Vote(residual, view, roi, noise_sigma);
  }
  Dilate();
  SpreadHidden();
}

}  // namespace trem
