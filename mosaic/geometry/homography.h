#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <span>

#include "mosaic/base/status.h"
#include "mosaic/geometry/affine.h"

namespace trem {

// A planar projective map, named target_from_source:
//
//   [x_target, 1]' ~ H [x_source, 1]',   H in R^{3x3}, det(H) != 0
//
// Pixel coordinates; (0, 0) is the centre of the upper left pixel. Source: Hartley & Zisserman, Multiple View Geometry, 2nd ed., 2.3.
struct Homography {
  Eigen::Matrix3d matrix = Eigen::Matrix3d::Identity();

  static Homography FromAffine(const Affine& affine);
  // Maps `x_source`. Precondition: not on the horizon (the third coordinate is not 0); see Depth.
  Eigen::Vector2d operator*(const Eigen::Vector2d& x_source) const;
  // The homogeneous third coordinate of the image of `x_source`: its sign tells the side of the horizon.
  double Depth(const Eigen::Vector2d& x_source) const;
  Homography operator*(const Homography& b_from_a) const { return {matrix * b_from_a.matrix}; }
  Homography Inverse() const;
  // Scaled so that matrix(2, 2) == 1. Precondition: matrix(2, 2) != 0.
  Homography Normalised() const;
  // The affine map that agrees with this one to first order at `x_source`. Precondition: not on the horizon.
  Affine LinearisedAt(const Eigen::Vector2d& x_source) const;
};

// Least squares (algebraic, Hartley-normalised DLT; H&Z 4.4.4) over n >= 4 pairs of points, no three of the first four collinear.
// kFailed when the points do not determine a homography.
Result<Homography> FitHomography(std::span<const Eigen::Vector2d> x_source, std::span<const Eigen::Vector2d> x_target);
// Least squares over n >= 3 non-collinear pairs.
Result<Affine> FitAffine(std::span<const Eigen::Vector2d> x_source, std::span<const Eigen::Vector2d> x_target);

}  // namespace trem
