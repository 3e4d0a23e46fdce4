#include "worker/registration/scene_support.h"

#include <cmath>

#include "worker/sensor/bicubic.h"

namespace trem {

SceneSupport MeasureSupport(const Observation& observation, const Reference& reference, const View& view) {
  constexpr int kStride = 4;
  const Roi& roi = observation.roi;
  double weights = 0.0;
  double squares = 0.0;
  for (int v = kStride / 2; v < roi.height(); v += kStride) {
    for (int u = kStride / 2; u < roi.width(); u += kStride) {
      if (std::isnan(observation.roi_pixels->at(u, v)) || !(observation.weight(u, v) > 0.0F)) continue;
      const Eigen::Vector2d cell = view.scene_from_sensor * Eigen::Vector2d(roi.x0 + u, roi.y0 + v);
      const double x = cell.x() - reference.x0;
      const double y = cell.y() - reference.y0;
      if (!CubicSupported(*reference.seen, x, y)) continue;
      const double n = reference.seen->at(static_cast<int>(x + 0.5), static_cast<int>(y + 0.5));
      if (!(n >= reference.seen_min) || !(n > 0.0)) continue;
      const double weight = n / (n + 1.0);
      weights += weight;
      squares += weight * weight;
    }
  }
  return weights > 0.0 ? SceneSupport{squares / weights} : SceneSupport{};
}

}  // namespace trem
