#include "worker/tre/frame_residual.h"

#include <algorithm>
#include <vector>

#include "mosaic/base/parallel.h"
#include "worker/sensor/filter_rows.h"
#include "worker/tre/update_kernels.h"
#include "worker/tre/view_row.h"

namespace trem {
namespace {

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

void FrameResidual::Explain(const Observation& observation, int begin, int end) {
  const int width = predicted.width();
  const int last = predicted.height() - 1;
  // A value to either side: beyond the frame there is none.
  const std::size_t stride = static_cast<std::size_t>(width) + 2 + kRowSlack;
  std::vector<float> lines(2 * stride);
  float* const low = lines.data() + 1;
  float* const high = low + stride;
  ExplainedRow row;
  row.low = low;
  row.high = high;
  row.noise2 = static_cast<float>(observation.noise_sigma * observation.noise_sigma);
  row.settled_part = kSettledPart;
  row.fresh_part = kFreshPart;
  row.seen_min = kSeenMin;
  for (int v = begin; v < end; ++v) {
    const float* const rows[] = {predicted.row(std::max(v - 1, 0)), predicted.row(v), predicted.row(std::min(v + 1, last))};
    RangeOfRows(rows, width, low, high);
    low[-1] = low[width] = kFar;
    high[-1] = high[width] = -kFar;
    row.predicted = predicted.row(v);
    row.frames = frames_seen.row(v);
    row.pixels = observation.roi_pixels->row(v);
    row.weights = observation.weights != nullptr ? observation.weights->row(v) : nullptr;
    ExplainRow(row, width, variance.row(v), value.row(v));
  }
}

void FrameResidual::Compute(const Observation& observation, const View& view, const SceneBuffer& buffer, int threads) {
  const int width = observation.roi.width();
  const int height = observation.roi.height();
  for (Image<float>* plane : {&predicted, &value, &variance, &frames_seen}) FitSize(width, height, plane);
  const int bands = (height + kBandRows - 1) / kBandRows;
  const auto for_bands = [&](const auto& body) {
    ForEachIndex(threads, bands, [&](int band, int) { body(band * kBandRows, std::min((band + 1) * kBandRows, height)); });
  };
  for_bands([&](int begin, int end) { Predict(observation, view, buffer, begin, end); });
  for_bands([&](int begin, int end) { Explain(observation, begin, end); });
}

}  // namespace trem
