#include "mosaic/geometry/ground_surface.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace trem {
namespace {

constexpr int kStepsMax = 20'000;
constexpr double kTolerance_m = 1e-3;
constexpr double kSlack_m = 0.01;

}  // namespace

GriddedGround::GriddedGround(const Eigen::Vector2d& origin, const Eigen::Vector2d& step, Image<float> elevations_m)
    : origin_(origin), step_(step), elevations_m_(std::move(elevations_m)) {
  TREM_CHECK(elevations_m_.width() >= 2 && elevations_m_.height() >= 2);
  TREM_CHECK(step_.x() != 0.0 && step_.y() != 0.0);
  lowest_m_ = std::numeric_limits<double>::infinity();
  highest_m_ = -lowest_m_;
  for (const float z : elevations_m_.pixels()) {
    if (!std::isfinite(z)) continue;
    lowest_m_ = std::min(lowest_m_, static_cast<double>(z));
    highest_m_ = std::max(highest_m_, static_cast<double>(z));
  }
  TREM_CHECK_MSG(lowest_m_ <= highest_m_, "a ground without a known node");
}

std::optional<double> GriddedGround::ElevationAt(const Eigen::Vector2d& x) const {
  const Eigen::Array2d node = (x - origin_).array() / step_.array();
  const double columns = elevations_m_.width() - 1;
  const double rows = elevations_m_.height() - 1;
  // The slack keeps the outermost nodes inside in spite of rounding.
  if (!(node.x() >= -1e-9 && node.x() <= columns + 1e-9 && node.y() >= -1e-9 && node.y() <= rows + 1e-9)) return std::nullopt;
  const int c = std::clamp(static_cast<int>(node.x()), 0, elevations_m_.width() - 2);
  const int r = std::clamp(static_cast<int>(node.y()), 0, elevations_m_.height() - 2);
  const double fx = node.x() - c;
  const double fy = node.y() - r;
  const double top = (1.0 - fx) * elevations_m_.at(c, r) + fx * elevations_m_.at(c + 1, r);
  const double bottom = (1.0 - fx) * elevations_m_.at(c, r + 1) + fx * elevations_m_.at(c + 1, r + 1);
  const double z = (1.0 - fy) * top + fy * bottom;
  return std::isfinite(z) ? std::optional<double>(z) : std::nullopt;
}

double GriddedGround::spacing() const { return step_.cwiseAbs().minCoeff(); }

double GriddedGround::mean_m() const {
  double sum = 0.0;
  double count = 0.0;
  for (const float z : elevations_m_.pixels()) {
    if (!std::isfinite(z)) continue;
    sum += z;
    count += 1.0;
  }
  return sum / count;
}

std::optional<Eigen::Vector3d> IntersectSurface(const Eigen::Vector3d& position_m, const Eigen::Vector3d& direction,
                                                const GroundSurface& surface) {
  const double length = direction.norm();
  if (!(length > 0.0) || !(direction.z() < -1e-9 * length)) return std::nullopt;
  // Only between the highest and the lowest ground can the ray meet it. Distances s are along `unit`.
  const Eigen::Vector3d unit = direction / length;
  // The slack leaves a stretch to search where both are the same.
  const double first = std::max(0.0, (surface.highest_m() - position_m.z() + kSlack_m) / unit.z());
  const double last = (surface.lowest_m() - position_m.z() - kSlack_m) / unit.z();
  if (!(position_m.z() > surface.lowest_m())) return std::nullopt;
  const auto at = [&](double s) { return Eigen::Vector3d(position_m + s * unit); };
  // Height above ground; nothing where there is none.
  const auto clearance = [&](double s) -> std::optional<double> {
    const Eigen::Vector3d x = at(s);
    const std::optional<double> z = surface.ElevationAt(x.head<2>());
    return z.has_value() ? std::optional<double>(x.z() - *z) : std::nullopt;
  };
  if (surface.spacing() == 0.0) {
    Eigen::Vector3d x = at((surface.lowest_m() - position_m.z()) / unit.z());
    x.z() = surface.lowest_m();
    return x;
  }
  const double level_m = std::max(1e-6, unit.head<2>().norm());
  const double step = std::max(0.5 * surface.spacing() / level_m, (last - first) / kStepsMax);
  std::optional<double> above = clearance(first);
  if (above.has_value() && *above < 0.0) return std::nullopt;
  double low = first;
  while (low < last) {
    const double high = std::min(last, low + step);
    const std::optional<double> next = clearance(high);
    if (above.has_value() && next.has_value() && *next <= 0.0) {
      double a = low;
      double b = high;
      while (b - a > kTolerance_m) {
        const double middle = 0.5 * (a + b);
        const std::optional<double> value = clearance(middle);
        if (!value.has_value()) return std::nullopt;
        (*value > 0.0 ? a : b) = middle;
      }
      return at(b);
    }
    // Below the ground without having been seen above it: the crossing lies where nothing is known.
    if (next.has_value() && *next < 0.0) return std::nullopt;
    above = next;
    low = high;
  }
  return std::nullopt;
}

std::optional<Eigen::Vector3d> IntersectSurface(const CameraPose& pose, const CameraIntrinsics& intrinsics, const GroundSurface& surface,
                                                const Eigen::Vector2d& u) {
  const Eigen::Vector3d ray((u.x() - 0.5 * (intrinsics.width_px - 1)) / intrinsics.focal_px,
                            (u.y() - 0.5 * (intrinsics.height_px - 1)) / intrinsics.focal_px, 1.0);
  return IntersectSurface(pose.position_m, WorldFromCamera(pose.yaw_rad, pose.pitch_rad, pose.roll_rad) * ray, surface);
}

}  // namespace trem
