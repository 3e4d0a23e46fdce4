#pragma once

#include <Eigen/Core>
#include <Eigen/LU>

#include "mosaic/geometry/affine.h"
#include "mosaic/geometry/homography.h"

namespace trem {

// A planar projective map with the affine ones as its special case, named target_from_source:
//
//   x_target = (linear * x_source + offset) / (1 + perspective . x_source)
//
// linear in R^{2x2}, offset in R^2, perspective in R^2 [1 / source px]; perspective == 0: affine, and computed as such. It is the
// homography [linear, offset; perspective', 1], so that the source's origin must not lie on the horizon: meant for maps between views
// of one plane that are near enough for that. Pixel coordinates; (0, 0) is the centre of the upper left pixel.
struct PlanarMap {
  Eigen::Matrix2d linear = Eigen::Matrix2d::Identity();
  Eigen::Vector2d offset = Eigen::Vector2d::Zero();
  Eigen::Vector2d perspective = Eigen::Vector2d::Zero();

  PlanarMap() = default;
  // Every affine map is a planar map.
  PlanarMap(const Affine& affine) : linear(affine.linear), offset(affine.offset) {}  // NOLINT(google-explicit-constructor)
  PlanarMap(const Eigen::Matrix2d& a, const Eigen::Vector2d& b, const Eigen::Vector2d& p = Eigen::Vector2d::Zero())
      : linear(a), offset(b), perspective(p) {}
  // Precondition: matrix(2, 2) != 0.
  static PlanarMap FromHomography(const Homography& h) {
    const Eigen::Matrix3d m = h.matrix / h.matrix(2, 2);
    return {m.topLeftCorner<2, 2>(), m.topRightCorner<2, 1>(), m.bottomLeftCorner<1, 2>().transpose()};
  }
  Homography ToHomography() const {
    Homography h;
    h.matrix << linear, offset, perspective.transpose(), 1.0;
    return h;
  }

  bool IsAffine() const { return perspective.x() == 0.0 && perspective.y() == 0.0; }
  // The denominator at `x_source`; positive on the origin's side of the horizon.
  double Depth(const Eigen::Vector2d& x_source) const { return 1.0 + perspective.dot(x_source); }
  // Precondition: Depth(x_source) != 0.
  Eigen::Vector2d operator*(const Eigen::Vector2d& x_source) const {
    const Eigen::Vector2d numerator = linear * x_source + offset;
    return IsAffine() ? numerator : Eigen::Vector2d(numerator / Depth(x_source));
  }
  // (c_from_b * b_from_a) maps a to c. Precondition: a's origin does not end on the horizon.
  PlanarMap operator*(const PlanarMap& b_from_a) const {
    if (IsAffine() && b_from_a.IsAffine()) return {linear * b_from_a.linear, linear * b_from_a.offset + offset};
    return FromHomography(ToHomography() * b_from_a.ToHomography());
  }
  // Precondition: not singular, and the target's origin not on the horizon.
  PlanarMap Inverse() const {
    if (IsAffine()) return Affine{linear, offset}.Inverse();
    return FromHomography(ToHomography().Inverse());
  }
  // The affine map that agrees with this one to first order at `x_source`. Precondition: Depth(x_source) != 0.
  Affine LinearisedAt(const Eigen::Vector2d& x_source) const {
    if (IsAffine()) return {linear, offset};
    return ToHomography().LinearisedAt(x_source);
  }
};

}  // namespace trem
