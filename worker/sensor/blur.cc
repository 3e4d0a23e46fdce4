#include "worker/sensor/blur.h"

#include <algorithm>

#include "worker/sensor/filter_rows.h"
#include "worker/sensor/reflect.h"

namespace trem {

void Blur::Apply(const Image<float>& input, const Roi& region, Image<float>* output) {
  TREM_CHECK(output != &input && output->width() == input.width() && output->height() == input.height());
  const Roi clipped = Intersect(region, {0, 0, input.width(), input.height()});
  if (clipped.empty()) return;
  if (!psf_.is_rank_one_symmetric()) {
    terms_.Apply(psf_, input, clipped, output);
    return;
  }
  const int radius = psf_.radius();
  // Columns first: a row of their sums stays in the fastest cache until it is filtered along itself.
  const int begin = std::max(clipped.x0 - radius, 0);
  const int end = std::min(clipped.x1 + radius, input.width());
  line_.resize(static_cast<std::size_t>(clipped.width() + 2 * radius + kRowSlack));
  source_.resize(static_cast<std::size_t>(2 * radius + 1));
  float* const line = line_.data() + radius - clipped.x0;  // line[x] is column x of the image.
  for (int y = clipped.y0; y < clipped.y1; ++y) {
    for (int k = -radius; k <= radius; ++k) {
      source_[static_cast<std::size_t>(k + radius)] = input.row(ReflectIndex(y + k, input.height())) + begin;
    }
    FilterColumns(source_.data(), psf_.taps.data(), radius, end - begin, line + begin);
    ReflectRow(line, clipped.x0 - radius, clipped.x1 + radius, input.width());
    FilterRow(line + clipped.x0, psf_.taps.data(), radius, clipped.width(), output->row(y) + clipped.x0);
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
