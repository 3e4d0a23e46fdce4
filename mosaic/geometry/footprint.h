#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "mosaic/base/status.h"
#include "mosaic/geometry/homography.h"
#include "mosaic/geometry/roi.h"

namespace trem {

// The visible side of a homography's horizon. A homography is defined up to scale, so the sign of its depth means something only once
// it is fixed at a point that is known to be visible: these functions want maps from NormalisedAt.

// Depths outside (kDepthMin, 1 / kDepthMin), relative to the reference point's, count as on the horizon.
inline constexpr double kDepthMin = 1e-6;

// `h` scaled so that Depth(x_visible) == 1. kFailed when `x_visible` lies on the horizon or `h` is singular.
Result<Homography> NormalisedAt(const Homography& h, const Eigen::Vector2d& x_visible);

inline bool IsVisibleDepth(double depth) { return depth > kDepthMin && depth < 1.0 / kDepthMin; }

// The outer edges of `roi`'s pixels (half a pixel outside their centres) mapped to the target and clipped to the visible side: a convex
// polygon in the order upper left, upper right, lower right, lower left of the source; empty when nothing is visible. Precondition:
// `target_from_source` comes from NormalisedAt or is the inverse of such a map.
std::vector<Eigen::Vector2d> ProjectRoi(const Homography& target_from_source, const Roi& roi);

// The smallest rectangle of target pixels whose centres can lie in the polygon, clipped to `limit`; empty (nullopt) when there is none.
std::optional<Roi> BoundingRoi(const std::vector<Eigen::Vector2d>& polygon, const Roi& limit);

}  // namespace trem
