#include "worker/simulate/aim_path.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

namespace trem {
namespace {

constexpr double kSpeedPxMax = 4.0;     // Chosen speeds stay below: neighbouring frames overlap almost wholly.
constexpr double kDwellRadiusPx = 8.0;  // The aim point of a dwell goes around a circle of this size
constexpr double kDwellSpeedPx = 0.7;   // at this speed.

Eigen::Vector2d AlongPolyline(const std::vector<Eigen::Vector2d>& corners, double distance_m) {
  for (std::size_t i = 0; i + 1 < corners.size(); ++i) {
    const Eigen::Vector2d step = corners[i + 1] - corners[i];
    const double length = step.norm();
    if (distance_m <= length || i + 2 == corners.size()) return corners[i] + step * (length > 0.0 ? distance_m / length : 0.0);
    distance_m -= length;
  }
  return corners.front();
}

double Length(const std::vector<Eigen::Vector2d>& corners) {
  double sum = 0.0;
  for (std::size_t i = 0; i + 1 < corners.size(); ++i) sum += (corners[i + 1] - corners[i]).norm();
  return sum;
}

// Legs along axis `along` (0: east, 1: north) over the centred part of the free box, `leg_m` long and `spacing_m` apart.
std::vector<Eigen::Vector2d> Legs(const Eigen::Vector2d& centre, int along, double leg_m, int leg_count, double spacing_m) {
  std::vector<Eigen::Vector2d> corners;
  for (int leg = 0; leg < leg_count; ++leg) {
    const double across_m = (leg - 0.5 * (leg_count - 1)) * spacing_m;
    for (const double sign : {-1.0, 1.0}) {
      Eigen::Vector2d corner = centre;
      corner[along] += (leg % 2 == 0 ? sign : -sign) * 0.5 * leg_m;
      corner[1 - along] += across_m;
      corners.push_back(corner);
    }
  }
  return corners;
}

Status TooLong(const SimulationOptions& options, double available_m) {
  const double available_px = available_m / options.gsd_m;
  return InvalidInput(
      fmt::format("{} frames at --speed-px {:.3g} make a path of {:.0f} sensor pixels, but inside the truth there is room for {:.0f}; use "
                  "--frames {} or --speed-px {:.2f} or less, or a larger truth",
                  options.frame_count, options.speed_px, options.speed_px * (options.frame_count - 1), available_px,
                  static_cast<int>(available_px / options.speed_px) + 1, available_px / (options.frame_count - 1)));
}

Result<std::vector<Eigen::Vector2d>> LawnmowerCorners(const SimulationOptions& options, const AimLimits& limits,
                                                      const Eigen::Vector2d& centre, const Eigen::Vector2d& free_m) {
  const int along = free_m.x() >= free_m.y() ? 0 : 1;
  const Eigen::Vector2d footprint_m = limits.footprint_high_m - limits.footprint_low_m;
  const double spacing_m = (1.0 - options.sidelap) * footprint_m[1 - along];
  int leg_count = static_cast<int>(free_m[1 - along] / spacing_m) + 1;
  if (leg_count < 2) {
    return InvalidInput(fmt::format(
        "a lawnmower needs two legs {:.1f} m apart, but the truth leaves {:.1f} m; use --path line, a larger --sidelap than {}, "
        "a smaller --height, or a larger truth",
        spacing_m, free_m[1 - along], options.sidelap));
  }
  const double wish_m = (options.frame_count - 1) * (options.speed_px > 0.0 ? options.speed_px : kSpeedPxMax) * options.gsd_m;
  const auto leg_for = [&](int legs) { return (wish_m - (legs - 1) * spacing_m) / legs; };
  // Too few frames for all legs at full length: fewer legs first, shorter ones then.
  while (leg_count > 2 && leg_for(leg_count) < 0.5 * free_m[along]) --leg_count;
  const double leg_m = std::clamp(leg_for(leg_count), 0.0, free_m[along]);
  if (leg_m <= 0.0) {
    return InvalidInput(fmt::format("{} frames are too few for two legs {:.1f} m apart; use more --frames or a larger --speed-px",
                                    options.frame_count, spacing_m));
  }
  return Legs(centre, along, leg_m, leg_count, spacing_m);
}

AimPath Dwell(const SimulationOptions& options, const Eigen::Vector2d& centre, const Eigen::Vector2d& free_m) {
  AimPath path;
  path.speed_px = options.speed_px > 0.0 ? options.speed_px : kDwellSpeedPx;
  const double radius_m = std::min(kDwellRadiusPx * options.gsd_m, 0.5 * free_m.minCoeff());
  for (int i = 0; i < options.frame_count; ++i) {
    const double angle = radius_m > 0.0 ? path.speed_px * options.gsd_m * i / radius_m : 0.0;
    path.aim_m.push_back(centre + radius_m * Eigen::Vector2d(std::cos(angle), std::sin(angle)));
  }
  return path;
}

}  // namespace

Result<AimPath> PlanAimPath(const SimulationOptions& options, const AimLimits& limits) {
  const Eigen::Vector2d low = limits.truth_low_m - limits.footprint_low_m;
  const Eigen::Vector2d free_m = limits.truth_high_m - limits.footprint_high_m - low;
  if (free_m.minCoeff() < 0.0) {
    const Eigen::Vector2d footprint_m = limits.footprint_high_m - limits.footprint_low_m;
    const Eigen::Vector2d truth_m = limits.truth_high_m - limits.truth_low_m;
    return InvalidInput(
        fmt::format("the truth covers {:.1f} x {:.1f} m, but a frame and its jitter need {:.1f} x {:.1f} m; use a smaller --width or "
                    "--height, a steeper --pitch-deg, fewer --truth-cells-per-pixel, or a larger truth",
                    truth_m.x(), truth_m.y(), footprint_m.x(), footprint_m.y()));
  }
  const Eigen::Vector2d centre = low + 0.5 * free_m;
  if (options.path == SimulatedPath::kDwell) return Dwell(options, centre, free_m);

  std::vector<Eigen::Vector2d> corners;
  if (options.path == SimulatedPath::kLine) {
    const int along = free_m.x() >= free_m.y() ? 0 : 1;
    corners = Legs(centre, along, free_m[along], 1, 0.0);
  } else {
    TREM_ASSIGN_OR_RETURN(corners, LawnmowerCorners(options, limits, centre, free_m));
  }
  const double available_m = Length(corners);
  const int steps = std::max(1, options.frame_count - 1);
  AimPath path;
  path.speed_px = options.speed_px > 0.0 ? options.speed_px : std::min(kSpeedPxMax, available_m / options.gsd_m / steps);
  const double needed_m = path.speed_px * options.gsd_m * (options.frame_count - 1);
  if (needed_m > available_m * (1.0 + 1e-9)) return TooLong(options, available_m);
  // A path shorter than the room for it lies in the middle.
  const double start_m = 0.5 * std::max(0.0, available_m - needed_m);
  for (int i = 0; i < options.frame_count; ++i) {
    path.aim_m.push_back(AlongPolyline(corners, start_m + path.speed_px * options.gsd_m * i));
  }
  return path;
}

}  // namespace trem
