#include "mosaic/geometry/homography.h"

#include <Eigen/QR>
#include <Eigen/SVD>
#include <cmath>

namespace trem {
namespace {

// The similarity that moves the points' centroid to 0 and their mean distance from it to sqrt(2).
Eigen::Matrix3d Normaliser(std::span<const Eigen::Vector2d> points) {
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& p : points) centre += p;
  centre /= static_cast<double>(points.size());
  double distance = 0.0;
  for (const Eigen::Vector2d& p : points) distance += (p - centre).norm();
  distance /= static_cast<double>(points.size());
  const double scale = distance > 0.0 ? std::sqrt(2.0) / distance : 1.0;
  Eigen::Matrix3d t;
  t << scale, 0.0, -scale * centre.x(), 0.0, scale, -scale * centre.y(), 0.0, 0.0, 1.0;
  return t;
}

}  // namespace

Homography Homography::FromAffine(const Affine& affine) {
  Homography h;
  h.matrix.topLeftCorner<2, 2>() = affine.linear;
  h.matrix.topRightCorner<2, 1>() = affine.offset;
  return h;
}

Eigen::Vector2d Homography::operator*(const Eigen::Vector2d& x_source) const {
  const Eigen::Vector3d y = matrix * x_source.homogeneous();
  return y.head<2>() / y.z();
}

double Homography::Depth(const Eigen::Vector2d& x_source) const { return matrix.row(2) * x_source.homogeneous(); }

Homography Homography::Inverse() const { return {matrix.inverse()}; }

Homography Homography::Normalised() const { return {matrix / matrix(2, 2)}; }

Affine Homography::LinearisedAt(const Eigen::Vector2d& x_source) const {
  const Eigen::Vector3d y = matrix * x_source.homogeneous();
  const Eigen::Vector2d x_target = y.head<2>() / y.z();
  Affine a;
  a.linear = (matrix.topLeftCorner<2, 2>() - x_target * matrix.bottomLeftCorner<1, 2>()) / y.z();
  a.offset = x_target - a.linear * x_source;
  return a;
}

Result<Homography> FitHomography(std::span<const Eigen::Vector2d> x_source, std::span<const Eigen::Vector2d> x_target) {
  TREM_CHECK(x_source.size() == x_target.size());
  if (x_source.size() < 4) return Failed("a homography needs 4 pairs of points; found " + std::to_string(x_source.size()));
  const Eigen::Matrix3d t_source = Normaliser(x_source);
  const Eigen::Matrix3d t_target = Normaliser(x_target);
  Eigen::Matrix<double, 9, 9> normal = Eigen::Matrix<double, 9, 9>::Zero();
  for (std::size_t i = 0; i < x_source.size(); ++i) {
    const Eigen::Vector3d s = t_source * x_source[i].homogeneous();
    const Eigen::Vector3d t = t_target * x_target[i].homogeneous();
    Eigen::Matrix<double, 2, 9> rows = Eigen::Matrix<double, 2, 9>::Zero();
    rows.block<1, 3>(0, 0) = s.transpose();
    rows.block<1, 3>(0, 6) = -t.x() * s.transpose();
    rows.block<1, 3>(1, 3) = s.transpose();
    rows.block<1, 3>(1, 6) = -t.y() * s.transpose();
    normal += rows.transpose() * rows;
  }
  const Eigen::JacobiSVD<Eigen::Matrix<double, 9, 9>> svd(normal, Eigen::ComputeFullV);
  // Two vanishing singular values: more than one homography fits (collinear or repeated points).
  if (!(svd.singularValues()(7) > 1e-12 * svd.singularValues()(0))) return Failed("the points do not determine a homography");
  const Eigen::Matrix<double, 9, 1> h = svd.matrixV().col(8);
  Eigen::Matrix3d normalised;
  normalised << h(0), h(1), h(2), h(3), h(4), h(5), h(6), h(7), h(8);
  Homography result{t_target.inverse() * normalised * t_source};
  if (!result.matrix.allFinite() || std::abs(result.matrix.determinant()) < 1e-300) return Failed("the homography is singular");
  if (std::abs(result.matrix(2, 2)) > 1e-12) result = result.Normalised();
  return result;
}

Result<Affine> FitAffine(std::span<const Eigen::Vector2d> x_source, std::span<const Eigen::Vector2d> x_target) {
  TREM_CHECK(x_source.size() == x_target.size());
  if (x_source.size() < 3) return Failed("an affine map needs 3 pairs of points; found " + std::to_string(x_source.size()));
  Eigen::MatrixXd a(static_cast<Eigen::Index>(x_source.size()), 3);
  Eigen::MatrixXd b(static_cast<Eigen::Index>(x_source.size()), 2);
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& p : x_source) centre += p;
  centre /= static_cast<double>(x_source.size());
  for (std::size_t i = 0; i < x_source.size(); ++i) {
    a.row(static_cast<Eigen::Index>(i)) << (x_source[i] - centre).transpose(), 1.0;
    b.row(static_cast<Eigen::Index>(i)) = x_target[i].transpose();
  }
  const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(a);
  if (qr.rank() < 3) return Failed("the points are collinear and do not determine an affine map");
  const Eigen::MatrixXd x = qr.solve(b);
  Affine result;
  result.linear = x.topRows<2>().transpose();
  result.offset = x.row(2).transpose() - result.linear * centre;
  return result;
}

}  // namespace trem
