#include "worker/sensor/blur.h"

#include <algorithm>

#include "worker/sensor/filter_rows.h"
#include "worker/sensor/reflect.h"

namespace trem {
namespace {

// Rows filtered at a time: what their columns share is fetched once.
constexpr int kBlock = 16;

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
  FilterBlock block;
  block.taps = psf_.taps.data();
  block.radius = radius;
  block.begin = clipped.x0;
  block.end = clipped.x1;
  block.width = input.width();
  block.first = std::max(clipped.x0 - radius, 0);
  const int before = radius + kRowSlack;  // Floats of a line before the first wanted column.
  block.stride = before + clipped.width() + radius + kRowSlack;
  lines_.resize(static_cast<std::size_t>(block.stride) * kFilterLines);
  block.lines = lines_.data() + (before - clipped.x0);
  source_.resize(static_cast<std::size_t>(2 * radius + kBlock));
  block.rows = source_.data();
  float* out[kBlock];
  for (int first = clipped.y0; first < clipped.y1; first += kBlock) {
    block.row_count = std::min(kBlock, clipped.y1 - first);
    for (int j = 0; j < block.row_count + 2 * radius; ++j) {
      source_[static_cast<std::size_t>(j)] = input.row(ReflectIndex(first + j - radius, input.height()));
    }
    for (int i = 0; i < block.row_count; ++i) out[i] = output->row(first + i);
    FilterRows(block, out);
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
