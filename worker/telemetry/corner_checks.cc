#include "worker/telemetry/corner_checks.h"

#include <fmt/format.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <numbers>

namespace trem {
namespace {

constexpr double kSideMax_m = 100e3;
constexpr double kMetresPerDegree = 111320.0;

// Metres east and north of the first corner; good to a per mille, which plausibility does not need.
Eigen::Vector2d FromFirst(const GeoPoint& first, const GeoPoint& at) {
  const double east_deg = std::remainder(at.longitude_deg - first.longitude_deg, 360.0);
  return {east_deg * kMetresPerDegree * std::cos(first.latitude_deg * std::numbers::pi / 180.0),
          (at.latitude_deg - first.latitude_deg) * kMetresPerDegree};
}

double Cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

// Why the corners are none; null: they may be.
const char* Objection(const TelemetryRecord& record) {
  const std::array<GeoPoint, 4>& corners = *record.corners;
  std::array<Eigen::Vector2d, 4> x;
  for (std::size_t k = 0; k < 4; ++k) {
    if (std::abs(corners[k].latitude_deg) < 1e-7 && std::abs(corners[k].longitude_deg) < 1e-7) return "lie at latitude 0, longitude 0";
    x[k] = FromFirst(corners[0], corners[k]);
  }
  for (std::size_t k = 0; k < 4; ++k) {
    const Eigen::Vector2d side = x[(k + 1) % 4] - x[k];
    const Eigen::Vector2d next = x[(k + 2) % 4] - x[(k + 1) % 4];
    if (side.norm() > kSideMax_m) return "are more than 100 km apart";
    if (Cross(side, next) >= 0.0)
      return "are no convex quadrilateral that runs clockwise (upper left, upper right, lower right, lower left)";
  }
  if (!record.frame_centre.has_value()) return nullptr;
  const Eigen::Vector2d centre = FromFirst(corners[0], *record.frame_centre);
  for (std::size_t k = 0; k < 4; ++k) {
    if (Cross(x[(k + 1) % 4] - x[k], centre - x[k]) >= 0.0) return "do not surround the frame centre";
  }
  return nullptr;
}

}  // namespace

CornerCheck CheckCorners(const std::vector<TelemetryRecord>& records) {
  CornerCheck check;
  int stated = 0;
  int odd = 0;
  const char* first = nullptr;
  for (const TelemetryRecord& record : records) {
    if (!record.corners.has_value()) continue;
    ++stated;
    const char* objection = Objection(record);
    if (objection == nullptr) {
      check.plausible.push_back({record.time_s, *record.corners});
    } else if (odd++ == 0) {
      first = objection;
    }
  }
  if (odd > 0)
    check.doubts.push_back(fmt::format("the image corners of {} of {} records are left out; the first: they {}", odd, stated, first));
  return check;
}

}  // namespace trem
