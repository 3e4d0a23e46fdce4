#include "worker/sensor/blur.h"

#include <algorithm>

#include "worker/sensor/reflect.h"

namespace trem {
namespace {

// out[x] = taps[0] * in[x] + sum_k taps[k] * (in[x - k] + in[x + k]).
void FilterRow(const float* in, const std::vector<float>& taps, int count, float* out) {
  const float centre = taps[0];
  for (int x = 0; x < count; ++x) out[x] = centre * in[x];
  for (std::size_t k = 1; k < taps.size(); ++k) {
    const float tap = taps[k];
    const float* left = in - k;
    const float* right = in + k;
    for (int x = 0; x < count; ++x) out[x] += tap * (left[x] + right[x]);
  }
}

void AddRows(const float* above, const float* below, float tap, int count, float* out) {
  for (int x = 0; x < count; ++x) out[x] += tap * (above[x] + below[x]);
}

}  // namespace

void Blur::Apply(const Image<float>& input, const Roi& region, Image<float>* output) {
  TREM_CHECK(output != &input && output->width() == input.width() && output->height() == input.height());
  const Roi clipped = Intersect(region, {0, 0, input.width(), input.height()});
  if (clipped.empty()) return;
  if (!psf_.is_rank_one_symmetric()) {
    terms_.Apply(psf_, input, clipped, output);
    return;
  }
  const int radius = psf_.radius();
  const int width = clipped.width();
  const int rows = clipped.height() + 2 * radius;
  if (rows_.width() != width || rows_.height() < rows) rows_ = Image<float>(width, rows);
  padded_.resize(static_cast<std::size_t>(width + 2 * radius));
  for (int i = 0; i < rows; ++i) {
    const float* source = input.row(ReflectIndex(clipped.y0 - radius + i, input.height()));
    const int x_begin = clipped.x0 - radius;
    const int x_end = clipped.x1 + radius;
    if (x_begin >= 0 && x_end <= input.width()) {
      FilterRow(source + clipped.x0, psf_.taps, width, rows_.row(i));
      continue;
    }
    for (int x = x_begin; x < x_end; ++x) padded_[static_cast<std::size_t>(x - x_begin)] = source[ReflectIndex(x, input.width())];
    FilterRow(padded_.data() + radius, psf_.taps, width, rows_.row(i));
  }
  for (int y = 0; y < clipped.height(); ++y) {
    float* out = output->row(clipped.y0 + y) + clipped.x0;
    const float* middle = rows_.row(y + radius);
    for (int x = 0; x < width; ++x) out[x] = psf_.taps[0] * middle[x];
    for (int k = 1; k <= radius; ++k) AddRows(rows_.row(y + radius - k), rows_.row(y + radius + k), psf_.taps[static_cast<std::size_t>(k)], width, out);
  }
}

void Blur::ApplyAdjoint(const Image<float>& input, const Roi& region, Image<float>* output) {
  if (psf_.is_rank_one_symmetric()) {
    Apply(input, region, output);
    return;
  }
  TREM_CHECK(output != &input && output->width() == input.width() && output->height() == input.height());
  const Roi clipped = Intersect(region, {0, 0, input.width(), input.height()});
  if (!clipped.empty()) terms_.ApplyAdjoint(psf_, input, clipped, output);
}

}  // namespace trem
