#include "worker/registration/view.h"

#include <algorithm>
#include <array>

#include "mosaic/base/check.h"

namespace trem {
namespace {

constexpr double kSigns[4] = {1.0, -1.0, -1.0, 1.0};

std::array<Eigen::Vector2d, 4> CornersOf(const Roi& roi) {
  return {Eigen::Vector2d(roi.x0, roi.y0), Eigen::Vector2d(roi.x1 - 1, roi.y0), Eigen::Vector2d(roi.x0, roi.y1 - 1),
          Eigen::Vector2d(roi.x1 - 1, roi.y1 - 1)};
}

double WidthOf(const Roi& roi) { return std::max(roi.width() - 1, 1); }
double HeightOf(const Roi& roi) { return std::max(roi.height() - 1, 1); }

// The sensor-space affine map that moves the first three corners by `d`.
Affine AffineMotion(const Roi& roi, const CornerVector& d) {
  Affine moved_from_sensor;
  const Eigen::Vector2d ul = d.segment<2>(0);
  moved_from_sensor.linear.col(0) += (d.segment<2>(2) - ul) / WidthOf(roi);
  moved_from_sensor.linear.col(1) += (d.segment<2>(4) - ul) / HeightOf(roi);
  moved_from_sensor.offset = Eigen::Vector2d(roi.x0, roi.y0) + ul - moved_from_sensor.linear * Eigen::Vector2d(roi.x0, roi.y0);
  return moved_from_sensor;
}

// The sensor-space homography that moves the four corners by `d`: the closed form of the unit square's (Heckbert 1989, 2.2.3).
PlanarMap ProjectiveMotion(const Roi& roi, const CornerVector& d) {
  const Eigen::Vector2d size(WidthOf(roi), HeightOf(roi));
  const Eigen::Vector2d origin(roi.x0, roi.y0);
  const auto moved = [&](int k) -> Eigen::Vector2d {
    return Eigen::Vector2d((k % 2) * size.x(), (k / 2) * size.y()) + d.segment<2>(2 * k);  // Relative to the ROI's corner.
  };
  const Eigen::Vector2d ul = moved(0), ur = moved(1), ll = moved(2), lr = moved(3);
  Eigen::Matrix2d sides;
  sides << ur - lr, ll - lr;
  const Eigen::Vector2d gh = sides.inverse() * (ul - ur - ll + lr);
  Homography moved_from_unit;
  moved_from_unit.matrix.col(0) << ur - ul + gh(0) * ur, gh(0);
  moved_from_unit.matrix.col(1) << ll - ul + gh(1) * ll, gh(1);
  moved_from_unit.matrix.col(2) << ul, 1.0;
  Homography unit_from_sensor;
  unit_from_sensor.matrix << 1.0 / size.x(), 0.0, -origin.x() / size.x(), 0.0, 1.0 / size.y(), -origin.y() / size.y(), 0.0, 0.0, 1.0;
  Homography sensor_from_relative;
  sensor_from_relative.matrix.topRightCorner<2, 1>() = origin;
  return PlanarMap::FromHomography(sensor_from_relative * moved_from_unit * unit_from_sensor);
}

}  // namespace

Eigen::Vector3d CornerWeights(const Roi& roi, const Eigen::Vector2d& u) {
  const double right = (u.x() - roi.x0) / WidthOf(roi);
  const double down = (u.y() - roi.y0) / HeightOf(roi);
  return {1.0 - right - down, right, down};
}

Eigen::Matrix<double, 2, Eigen::Dynamic, 0, 2, 8> CornerJacobian(const Roi& roi, const Eigen::Vector2d& u, ViewModel model) {
  const Eigen::Vector3d w = CornerWeights(roi, u);
  Eigen::Matrix<double, 2, Eigen::Dynamic, 0, 2, 8> jacobian(2, ParameterCount(model));
  jacobian.setZero();
  for (int k = 0; k < 3; ++k) jacobian(0, 2 * k) = jacobian(1, 2 * k + 1) = w(k);
  if (model == ViewModel::kAffine) return jacobian;
  const double s = w(1);
  const double t = w(2);
  const double shape = HeightOf(roi) / WidthOf(roi);
  for (int k = 0; k < 4; ++k) {
    jacobian(0, 2 * k) += kSigns[k] * s * t;
    jacobian(1, 2 * k) -= kSigns[k] * shape * t * (1.0 - t);
    jacobian(0, 2 * k + 1) -= kSigns[k] / shape * s * (1.0 - s);
    jacobian(1, 2 * k + 1) += kSigns[k] * s * t;
  }
  return jacobian;
}

PlanarMap Displace(const PlanarMap& scene_from_sensor, const Roi& roi, const CornerVector& d) {
  TREM_CHECK(d.size() == 6 || d.size() == 8);
  if (d.size() == 6) return scene_from_sensor * PlanarMap(AffineMotion(roi, d));
  return scene_from_sensor * ProjectiveMotion(roi, d);
}

CornerVector CornerDisplacement(const PlanarMap& from, const PlanarMap& to, const Roi& roi, ViewModel model) {
  const PlanarMap moved_from_sensor = from.Inverse() * to;
  const auto corners = CornersOf(roi);
  CornerVector d(ParameterCount(model));
  for (int k = 0; k < d.size() / 2; ++k) {
    const Eigen::Vector2d& corner = corners[static_cast<std::size_t>(k)];
    d.segment<2>(2 * k) = moved_from_sensor * corner - corner;
  }
  return d;
}

double LargestCornerMotion(const PlanarMap& a, const PlanarMap& b, const Roi& roi) {
  const PlanarMap moved_from_sensor = a.Inverse() * b;
  double largest = 0.0;
  for (const Eigen::Vector2d& corner : CornersOf(roi)) largest = std::max(largest, (moved_from_sensor * corner - corner).norm());
  return largest;
}

}  // namespace trem
