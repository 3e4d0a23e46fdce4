#include "worker/tre/scene_buffer.h"

#include <algorithm>
#include <array>

namespace trem {

SceneBuffer::SceneBuffer(const Roi& extent_in_scene) : extent(extent_in_scene) {
  const Image<float> blank(extent.width(), extent.height());
  scene = previous = weight = weighted = prediction = filled = majoriser = seen = blank;
  measured.resize(static_cast<std::size_t>(extent.height()));
}

void SceneBuffer::Forget(const Roi& cells) {
  for (int y = cells.y0; y < cells.y1; ++y) {
    for (Image<float>* plane : {&weight, &weighted, &seen}) std::fill(plane->row(y) + cells.x0, plane->row(y) + cells.x1, 0.0F);
    std::fill(filled.row(y) + cells.x0, filled.row(y) + cells.x1, kNotFilled);
    measured[static_cast<std::size_t>(y)] = {};
  }
  counted.region = {};
}

void SceneBuffer::MoveTo(const Roi& new_extent) {
  if (new_extent == extent) return;
  const Roi kept = Intersect(extent, new_extent);
  const std::array<Image<float>*, 8> planes = {&scene, &previous, &weight, &weighted, &prediction, &filled, &majoriser, &seen};
  for (Image<float>* plane : planes) {
    Image<float> moved(new_extent.width(), new_extent.height());
    for (int y = kept.y0; y < kept.y1; ++y) {
      const float* from = plane->row(y - extent.y0) + (kept.x0 - extent.x0);
      std::copy(from, from + std::max(kept.width(), 0), moved.row(y - new_extent.y0) + (kept.x0 - new_extent.x0));
    }
    *plane = std::move(moved);
  }
  extent = new_extent;
  // What lies beyond the border is reflected in, and has changed.
  counted.region = {};
  measured.assign(static_cast<std::size_t>(extent.height()), {});
}

Roi SceneBuffer::InBuffer(const Roi& region) const {
  return Intersect({region.x0 - extent.x0, region.y0 - extent.y0, region.x1 - extent.x0, region.y1 - extent.y0},
                   {0, 0, extent.width(), extent.height()});
}

}  // namespace trem
