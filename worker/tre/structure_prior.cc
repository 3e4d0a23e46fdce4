#include "worker/tre/structure_prior.h"

#include <algorithm>
#include <limits>

namespace trem {

void StructurePrior::AddGradient(const Image<float>& scene, const Roi& region, float weight, Image<float>* gradient) const {
  const float limit = kind == StructurePriorKind::kHuberTv ? delta : std::numeric_limits<float>::max();
  const auto slope = [limit, weight](float difference) { return weight * std::min(std::max(difference, -limit), limit); };
  for (int y = region.y0; y < region.y1; ++y) {
    const float* row = scene.row(y);
    const float* above = y > region.y0 ? scene.row(y - 1) : row;
    const float* below = y + 1 < region.y1 ? scene.row(y + 1) : row;
    float* out = gradient->row(y);
    const auto vertical = [&](int x) { return slope(row[x] - above[x]) + slope(row[x] - below[x]); };
    const int last = region.x1 - 1;
    out[region.x0] += vertical(region.x0) + (last > region.x0 ? slope(row[region.x0] - row[region.x0 + 1]) : 0.0F);
    for (int x = region.x0 + 1; x < last; ++x) out[x] += vertical(x) + slope(row[x] - row[x - 1]) + slope(row[x] - row[x + 1]);
    if (last > region.x0) out[last] += vertical(last) + slope(row[last] - row[last - 1]);
  }
}

}  // namespace trem
