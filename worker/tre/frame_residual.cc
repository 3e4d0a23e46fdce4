#include "worker/tre/frame_residual.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "worker/sensor/parallel.h"
#include "worker/tre/view_row.h"

namespace trem {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kFar = 1e9F;
// Rows that one thread takes at a time.
constexpr int kBandRows = 64;
// Less than about one frame behind a cell: nothing to compare with.
constexpr float kSeenMin = 0.75F;
// Model error as a part of the contrast, of a settled scene and of one frame's.
constexpr float kSettledPart = 0.10F;
constexpr float kFreshPart = 0.45F;

void FitSize(int width, int height, Image<float>* image) {
  if (image->width() != width || image->height() != height) *image = Image<float>(width, height);
}

}  // namespace

void FrameResidual::Predict(const Observation& observation, const View& view, const SceneBuffer& buffer, int begin, int end) {
  const Roi& roi = observation.roi;
  const Image<float>& prediction = buffer.prediction;
  const float gain = static_cast<float>(view.gain);
  const float offset = static_cast<float>(view.offset);
  const float left = static_cast<float>(buffer.extent.x0);
  const float top = static_cast<float>(buffer.extent.y0);
  const float x_max = static_cast<float>(prediction.width() - 1);
  const float y_max = static_cast<float>(prediction.height() - 1);
  for (int v = begin; v < end; ++v) {
    const ViewRow row(view.scene_from_sensor, roi, v);
    float* out = predicted.row(v);
    float* n = frames_seen.row(v);
    for (int u = 0; u < roi.width(); ++u) {
      float x = 0.0F;
      float y = 0.0F;
      row.At(u, &x, &y);
      x -= left;
      y -= top;
      out[u] = kNan;
      n[u] = 0.0F;
      if (!(x >= 0.0F && y >= 0.0F && x < x_max && y < y_max)) continue;
      const int ix = static_cast<int>(x);
      const int iy = static_cast<int>(y);
      const float tx = x - static_cast<float>(ix);
      const float ty = y - static_cast<float>(iy);
      const float seen = buffer.seen.at(ix + (tx >= 0.5F ? 1 : 0), iy + (ty >= 0.5F ? 1 : 0));
      if (!(seen >= kSeenMin)) continue;
      const float* above = prediction.row(iy) + ix;
      const float* below = prediction.row(iy + 1) + ix;
      const float upper = above[0] + tx * (above[1] - above[0]);
      const float lower = below[0] + tx * (below[1] - below[0]);
      out[u] = gain * (upper + ty * (lower - upper)) + offset;
      n[u] = seen;
    }
  }
}

// Over three rows; NaNs take no part.
void FrameResidual::FindRange(int begin, int end) {
  const int width = predicted.width();
  const int height = predicted.height();
  for (int v = begin; v < end; ++v) {
    const float* rows[] = {predicted.row(std::max(v - 1, 0)), predicted.row(v), predicted.row(std::min(v + 1, height - 1))};
    float* low = low_.row(v) + 1;
    float* high = high_.row(v) + 1;
    for (int u = 0; u < width; ++u) {
      float least = kFar;
      float most = -kFar;
      for (const float* row : rows) {
        least = row[u] < least ? row[u] : least;
        most = row[u] > most ? row[u] : most;
      }
      low[u] = least;
      high[u] = most;
    }
    low[-1] = low[width] = kFar;
    high[-1] = high[width] = -kFar;
  }
}

void FrameResidual::Explain(const Observation& observation, int begin, int end) {
  const int width = predicted.width();
  const float noise2 = static_cast<float>(observation.noise_sigma * observation.noise_sigma);
  for (int v = begin; v < end; ++v) {
    const float* low = low_.row(v) + 1;
    const float* high = high_.row(v) + 1;
    const float* n = frames_seen.row(v);
    const float* weight = observation.weights != nullptr ? observation.weights->row(v) : ones_.row(0);
    const float* frame = observation.roi_pixels->row(v);
    const float* mean = predicted.row(v);
    float* out = variance.row(v);
    float* residual = value.row(v);
    for (int u = 0; u < width; ++u) {
      const float contrast = std::max(high[u], std::max(high[u - 1], high[u + 1])) - std::min(low[u], std::min(low[u - 1], low[u + 1]));
      const float inverse_n = 1.0F / std::max(n[u], kSeenMin);
      const float part = (kSettledPart + kFreshPart * inverse_n) * std::max(contrast, 0.0F);
      out[u] = noise2 * (1.0F / std::max(weight[u], 1e-3F) + inverse_n) + part * part;
      residual[u] = weight[u] > 0.0F ? frame[u] - mean[u] : kNan;
    }
  }
}

void FrameResidual::Compute(const Observation& observation, const View& view, const SceneBuffer& buffer, int threads) {
  const int width = observation.roi.width();
  const int height = observation.roi.height();
  for (Image<float>* plane : {&predicted, &value, &variance, &frames_seen}) FitSize(width, height, plane);
  for (Image<float>* plane : {&low_, &high_}) FitSize(width + 2, height, plane);
  if (ones_.width() != width) ones_ = Image<float>(width, 1, 1.0F);
  const int bands = (height + kBandRows - 1) / kBandRows;
  const auto for_bands = [&](const auto& body) {
    ForEachIndex(threads, bands, [&](int band, int) { body(band * kBandRows, std::min((band + 1) * kBandRows, height)); });
  };
  for_bands([&](int begin, int end) { Predict(observation, view, buffer, begin, end); });
  for_bands([&](int begin, int end) {
    FindRange(begin, end);
    Explain(observation, begin, end);
  });
}

}  // namespace trem
