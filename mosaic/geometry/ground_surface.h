#pragma once

#include <Eigen/Core>
#include <optional>

#include "mosaic/base/image.h"
#include "mosaic/geometry/camera.h"

namespace trem {

// The ground as a function of place: elevation z = f(x), one z for each x (no overhangs). Coordinates are those of the caller's world
// (x east, y north, metres; see mosaic/align) or, for a grid made so, longitude and latitude in degrees; z in metres, in the vertical datum
// of the telemetry.
class GroundSurface {
 public:
  virtual ~GroundSurface() = default;

  // Nothing where the surface is not known.
  virtual std::optional<double> ElevationAt(const Eigen::Vector2d& x) const = 0;
  // Bounds of ElevationAt [m].
  virtual double lowest_m() const = 0;
  virtual double highest_m() const = 0;
  // Distance over which the surface may change its slope [units of x]; 0: it is a plane.
  virtual double spacing() const = 0;
};

// One elevation everywhere.
class LevelGround final : public GroundSurface {
 public:
  explicit LevelGround(double elevation_m) : elevation_m_(elevation_m) {}
  std::optional<double> ElevationAt(const Eigen::Vector2d&) const override { return elevation_m_; }
  double lowest_m() const override { return elevation_m_; }
  double highest_m() const override { return elevation_m_; }
  double spacing() const override { return 0.0; }

 private:
  double elevation_m_;
};

// Elevations at the nodes of a regular grid, bilinear between them:
//
//   node (c, r) lies at x = origin + (c * step.x, r * step.y)      (step.y < 0: rows run from north to south)
//
// NaN: unknown. Nothing is known outside the grid, nor in a cell with an unknown node.
class GriddedGround final : public GroundSurface {
 public:
  // Preconditions: at least 2 x 2 nodes, some of them known; both steps differ from 0.
  GriddedGround(const Eigen::Vector2d& origin, const Eigen::Vector2d& step, Image<float> elevations_m);

  std::optional<double> ElevationAt(const Eigen::Vector2d& x) const override;
  double lowest_m() const override { return lowest_m_; }
  double highest_m() const override { return highest_m_; }
  double spacing() const override;

  const Eigen::Vector2d& origin() const { return origin_; }
  const Eigen::Vector2d& step() const { return step_; }
  const Image<float>& elevations_m() const { return elevations_m_; }
  // Mean of the known nodes.
  double mean_m() const;

 private:
  Eigen::Vector2d origin_;
  Eigen::Vector2d step_;
  Image<float> elevations_m_;
  double lowest_m_ = 0.0;
  double highest_m_ = 0.0;
};

// Where the ray from `position_m` along `direction` (any length) first meets `surface`, in a metric world; nothing when it starts at or
// below the ground, does not descend to it, or leaves the known surface before. Marches in steps of half the surface's spacing (at most
// 20 000 of them, longer ones for longer rays), then bisects to a millimetre: relief narrower than that may be missed.
std::optional<Eigen::Vector3d> IntersectSurface(const Eigen::Vector3d& position_m, const Eigen::Vector3d& direction,
                                                const GroundSurface& surface);

// The same for the ray of sensor pixel `u`.
std::optional<Eigen::Vector3d> IntersectSurface(const CameraPose& pose, const CameraIntrinsics& intrinsics, const GroundSurface& surface,
                                                const Eigen::Vector2d& u);

}  // namespace trem
