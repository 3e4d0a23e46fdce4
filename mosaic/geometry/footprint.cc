#include "mosaic/geometry/footprint.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace trem {

Result<Homography> NormalisedAt(const Homography& h, const Eigen::Vector2d& x_visible) {
  const double depth = h.Depth(x_visible);
  const double scale = h.matrix.cwiseAbs().maxCoeff();
  if (!std::isfinite(depth) || !std::isfinite(scale) || std::abs(depth) <= 1e-12 * scale) {
    return Failed("the homography puts its reference point on the horizon");
  }
  const Homography normalised{h.matrix / depth};
  if (!(std::abs(normalised.matrix.determinant()) > 0.0)) return Failed("the homography is singular");
  return normalised;
}

std::vector<Eigen::Vector2d> ProjectRoi(const Homography& target_from_source, const Roi& roi) {
  if (roi.empty()) return {};
  const double x0 = roi.x0 - 0.5, y0 = roi.y0 - 0.5, x1 = roi.x1 - 0.5, y1 = roi.y1 - 0.5;
  const std::array<Eigen::Vector3d, 4> corners = {
      target_from_source.matrix * Eigen::Vector3d(x0, y0, 1.0), target_from_source.matrix * Eigen::Vector3d(x1, y0, 1.0),
      target_from_source.matrix * Eigen::Vector3d(x1, y1, 1.0), target_from_source.matrix * Eigen::Vector3d(x0, y1, 1.0)};
  // Sutherland-Hodgman against the plane depth = kDepthMin, in homogeneous coordinates, where edges stay straight.
  std::vector<Eigen::Vector2d> polygon;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const Eigen::Vector3d& a = corners[i];
    const Eigen::Vector3d& b = corners[(i + 1) % corners.size()];
    if (a.z() > kDepthMin) polygon.emplace_back(a.head<2>() / a.z());
    if ((a.z() > kDepthMin) != (b.z() > kDepthMin)) {
      const double t = (kDepthMin - a.z()) / (b.z() - a.z());
      const Eigen::Vector2d crossing = (1.0 - t) * a.head<2>() + t * b.head<2>();
      polygon.emplace_back(crossing / kDepthMin);
    }
  }
  return polygon;
}

std::optional<Roi> BoundingRoi(const std::vector<Eigen::Vector2d>& polygon, const Roi& limit) {
  if (polygon.empty() || limit.empty()) return std::nullopt;
  Eigen::Vector2d low = polygon[0], high = polygon[0];
  for (const Eigen::Vector2d& p : polygon) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  // Clamped before the conversion: near the horizon the numbers exceed any integer.
  const auto clamp = [](double value, int least, int most) {
    return static_cast<int>(std::clamp(value, static_cast<double>(least), static_cast<double>(most)));
  };
  const Roi roi{clamp(std::floor(low.x()), limit.x0, limit.x1), clamp(std::floor(low.y()), limit.y0, limit.y1),
                clamp(std::ceil(high.x()) + 1.0, limit.x0, limit.x1), clamp(std::ceil(high.y()) + 1.0, limit.y0, limit.y1)};
  if (roi.empty()) return std::nullopt;
  return roi;
}

}  // namespace trem
