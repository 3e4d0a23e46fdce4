#include "worker/sensor/forward_operator.h"

#include "worker/sensor/bicubic.h"

namespace trem {

Image<float> ForwardOperator::Apply(const Image<float>& scene) {
  Image<float> blurred(scene.width(), scene.height());
  blur_.Apply(scene, &blurred);
  Image<float> frame(frame_width_, frame_height_);
  for (int v = 0; v < frame_height_; ++v) {
    for (int u = 0; u < frame_width_; ++u) {
      const Eigen::Vector2d x = scene_from_sensor_ * Eigen::Vector2d(u, v);
      if (CubicSupported(blurred, x.x(), x.y())) frame.at(u, v) = SampleCubic(blurred, x.x(), x.y());
    }
  }
  return frame;
}

Image<float> ForwardOperator::ApplyAdjoint(const Image<float>& frame, int scene_width, int scene_height) {
  TREM_CHECK(frame.width() == frame_width_ && frame.height() == frame_height_);
  Image<float> splatted(scene_width, scene_height);
  for (int v = 0; v < frame_height_; ++v) {
    for (int u = 0; u < frame_width_; ++u) {
      const Eigen::Vector2d x = scene_from_sensor_ * Eigen::Vector2d(u, v);
      if (!CubicSupported(splatted, x.x(), x.y())) continue;
      const int ix = static_cast<int>(x.x());
      const int iy = static_cast<int>(x.y());
      const auto wx = CubicWeights(static_cast<float>(x.x() - ix));
      const auto wy = CubicWeights(static_cast<float>(x.y() - iy));
      for (std::size_t j = 0; j < 4; ++j) {
        float* p = splatted.row(iy - 1 + static_cast<int>(j)) + ix - 1;
        for (std::size_t i = 0; i < 4; ++i) p[i] += wy[j] * wx[i] * frame.at(u, v);
      }
    }
  }
  Image<float> scene(scene_width, scene_height);
  blur_.ApplyAdjoint(splatted, &scene);
  return scene;
}

}  // namespace trem
