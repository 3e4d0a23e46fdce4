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
  // Columns first: a few rows of their sums stay in the fastest cache until they are filtered along themselves.
  const int begin = std::max(clipped.x0 - radius, 0);
  const int end = std::min(clipped.x1 + radius, input.width());
  const int stride = clipped.width() + 2 * radius + kRowSlack;
  lines_.resize(static_cast<std::size_t>(stride) * static_cast<std::size_t>(kBlock));
  source_.resize(static_cast<std::size_t>(2 * radius + kBlock));
  for (int first = clipped.y0; first < clipped.y1; first += kBlock) {
    const int count = std::min(kBlock, clipped.y1 - first);
    for (int j = 0; j < count + 2 * radius; ++j) {
      source_[static_cast<std::size_t>(j)] = input.row(ReflectIndex(first + j - radius, input.height())) + begin;
    }
    const int shift = radius - clipped.x0;  // Column x of the image is at x + shift of a line.
    FilterColumnBlock(source_.data(), psf_.taps.data(), radius, count, end - begin, lines_.data() + begin + shift, stride);
    for (int i = 0; i < count; ++i) {
      float* const line = lines_.data() + static_cast<std::ptrdiff_t>(i) * stride;
      ReflectRow(line + shift, clipped.x0 - radius, clipped.x1 + radius, input.width());
      FilterRow(line + radius, psf_.taps.data(), radius, clipped.width(), output->row(first + i) + clipped.x0);
    }
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
