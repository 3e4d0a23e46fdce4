#include "worker/registration/view.h"

#include <algorithm>
#include <array>

namespace trem {
namespace {

std::array<Eigen::Vector2d, 4> CornersOf(const Roi& roi) {
  return {Eigen::Vector2d(roi.x0, roi.y0), Eigen::Vector2d(roi.x1 - 1, roi.y0), Eigen::Vector2d(roi.x0, roi.y1 - 1),
          Eigen::Vector2d(roi.x1 - 1, roi.y1 - 1)};
}

}  // namespace

Eigen::Vector3d CornerWeights(const Roi& roi, const Eigen::Vector2d& u) {
  const double right = (u.x() - roi.x0) / std::max(roi.width() - 1, 1);
  const double down = (u.y() - roi.y0) / std::max(roi.height() - 1, 1);
  return {1.0 - right - down, right, down};
}

Affine Displace(const Affine& scene_from_sensor, const Roi& roi, const CornerVector& d) {
  Affine moved_from_sensor;
  const Eigen::Vector2d ul = d.segment<2>(0);
  moved_from_sensor.linear.col(0) += (d.segment<2>(2) - ul) / std::max(roi.width() - 1, 1);
  moved_from_sensor.linear.col(1) += (d.segment<2>(4) - ul) / std::max(roi.height() - 1, 1);
  moved_from_sensor.offset = Eigen::Vector2d(roi.x0, roi.y0) + ul - moved_from_sensor.linear * Eigen::Vector2d(roi.x0, roi.y0);
  return scene_from_sensor * moved_from_sensor;
}

CornerVector CornerDisplacement(const Affine& from, const Affine& to, const Roi& roi) {
  const Affine moved_from_sensor = from.Inverse() * to;
  const auto corners = CornersOf(roi);
  CornerVector d;
  for (int k = 0; k < 3; ++k) {
    const Eigen::Vector2d& corner = corners[static_cast<std::size_t>(k)];
    d.segment<2>(2 * k) = moved_from_sensor * corner - corner;
  }
  return d;
}

double LargestCornerMotion(const Affine& a, const Affine& b, const Roi& roi) {
  const Affine moved_from_sensor = a.Inverse() * b;
  double largest = 0.0;
  for (const Eigen::Vector2d& corner : CornersOf(roi)) largest = std::max(largest, (moved_from_sensor * corner - corner).norm());
  return largest;
}

}  // namespace trem
