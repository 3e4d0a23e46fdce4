#include "worker/registration/scene_support.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "worker/sensor/bicubic.h"

namespace trem {

SceneSupport MeasureSupport(const Observation& observation, const Reference& reference, const View& view, ViewModel model) {
  constexpr int kStride = 4;
  constexpr double kWellPosed = 1e-6;
  const Roi& roi = observation.roi;
  const double width = std::max(roi.width() - 1, 1);
  const double height = std::max(roi.height() - 1, 1);
  double weights = 0.0;
  double squares = 0.0;
  Eigen::Matrix4d m0 = Eigen::Matrix4d::Zero(), m1 = m0, m2 = m0;
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
      const double s = u / width;
      const double t = v / height;
      // Projective: the bilinear weights, which its displacements differ little from.
      const Eigen::Vector4d q = model == ViewModel::kAffine ? Eigen::Vector4d(1.0 - s - t, s, t, 0.0)
                                                            : Eigen::Vector4d((1.0 - s) * (1.0 - t), s * (1.0 - t), (1.0 - s) * t, s * t);
      const Eigen::Matrix4d product = q * q.transpose();
      m0 += product;
      m1 += product / n;
      m2 += product / (n * n);
    }
  }
  if (!(weights > 0.0)) return {};
  SceneSupport support{squares / weights, Eigen::Matrix4d::Zero()};
  const Eigen::Index corners = ParameterCount(model) / 2;
  const Eigen::MatrixXd a = m0.topLeftCorner(corners, corners);
  if (!(std::abs(a.determinant()) > kWellPosed * std::pow(a.trace() / static_cast<double>(corners), corners))) return support;
  const Eigen::MatrixXd inverse = a.inverse();
  const Eigen::MatrixXd g = m1.topLeftCorner(corners, corners);
  const Eigen::MatrixXd h = m2.topLeftCorner(corners, corners);
  support.unevenness.topLeftCorner(corners, corners) =
      inverse * (h - g * inverse * g) * inverse / (inverse.trace() / static_cast<double>(corners));
  return support;
}

}  // namespace trem
