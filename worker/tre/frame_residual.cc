#include "worker/tre/frame_residual.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "worker/sensor/parallel.h"
#include "worker/tre/update_kernels.h"
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
  OverlaidRow row;
  row.prediction = buffer.prediction.row(0);
  row.seen = buffer.seen.row(0);
  row.width = buffer.prediction.width();
  row.height = buffer.prediction.height();
  row.left = static_cast<float>(buffer.extent.x0);
  row.top = static_cast<float>(buffer.extent.y0);
  row.seen_min = kSeenMin;
  row.gain = static_cast<float>(view.gain);
  row.offset = static_cast<float>(view.offset);
  for (int v = begin; v < end; ++v) {
    ViewRow(view.scene_from_sensor, roi, v).LayOver(&row);
    PredictRow(row, roi.width(), predicted.row(v), frames_seen.row(v));
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
