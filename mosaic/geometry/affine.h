#pragma once

#include <Eigen/Core>
#include <Eigen/LU>

namespace trem {

// A planar affine map, named target_from_source:
//
//   x_target = linear * x_source + offset,   linear in R^{2x2}, offset in R^2
//
// Pixel coordinates; (0, 0) is the centre of the upper left pixel of a grid.
struct Affine {
  Eigen::Matrix2d linear = Eigen::Matrix2d::Identity();
  Eigen::Vector2d offset = Eigen::Vector2d::Zero();

  Eigen::Vector2d operator*(const Eigen::Vector2d& x_source) const { return linear * x_source + offset; }
  // (c_from_b * b_from_a) maps a to c.
  Affine operator*(const Affine& b_from_a) const { return {linear * b_from_a.linear, linear * b_from_a.offset + offset}; }
  // Precondition: det(linear) != 0.
  Affine Inverse() const {
    Affine inverse;
    inverse.linear = linear.inverse();
    inverse.offset = -(inverse.linear * offset);
    return inverse;
  }
};

}  // namespace trem
