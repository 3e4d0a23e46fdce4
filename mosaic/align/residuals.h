#pragma once

#include <ceres/rotation.h>

#include <Eigen/Core>
#include <array>

#include "mosaic/align/align_state.h"
#include "mosaic/align/frames_and_scenes.h"

// Cost functors of the alignment (Ceres, automatic differentiation).
//
// Homographies are parametrised about their current value by eight numbers d:
//
//   D = [1 + d0, d1, d2; d3, 1 + d4, d5; d6, d7, 1]
//
// on coordinates scaled to -1..1 across the scene (world_from_scene = world_from_unit D unit_from_scene) or the image
// (sensor_from_world = sensor_from_unit D unit_from_world), so that every parameter is a displacement in half sizes. Frames are
// parametrised as sensor_from_world: residuals then come out in sensor pixels, which no scale of the world can shrink.
namespace trem::align {

inline constexpr int kMapParameters = 8;
inline constexpr int kCameraParameters = 6;  // dx, dy, dz [m], rotation about the camera's axes [rad].
inline constexpr int kLensParameters = 2;    // Log of the focal length's factor, k1; see Lens.

// Applies D to (x, y, w).
template <typename T>
Eigen::Matrix<T, 3, 1> ApplyDelta(const T* d, const Eigen::Matrix<T, 3, 1>& x) {
  return {(1.0 + d[0]) * x(0) + d[1] * x(1) + d[2] * x(2), d[3] * x(0) + (1.0 + d[4]) * x(1) + d[5] * x(2),
          d[6] * x(0) + d[7] * x(1) + x(2)};
}

// World point (homogeneous) of a point of the scene's unit square; false beyond the horizon.
template <typename T>
bool WorldFromUnit(const Eigen::Matrix3d& world_from_unit, const T* d, const Eigen::Vector2d& xi, Eigen::Matrix<T, 2, 1>* x_in_world) {
  const Eigen::Matrix<T, 3, 1> unit = ApplyDelta<T>(d, Eigen::Matrix<T, 3, 1>(T(xi.x()), T(xi.y()), T(1.0)));
  const Eigen::Matrix<T, 3, 1> world = world_from_unit.cast<T>() * unit;
  if (!(unit(2) > 1e-3) || !(world(2) > 1e-9)) return false;
  *x_in_world = world.template head<2>() / world(2);
  return true;
}

// The image of a sensor.
struct SensorFrame {
  double centre_x = 0.0;
  double centre_y = 0.0;
  double half_px = 1.0;
};

// The ground's elevation as a function that Ceres can differentiate.
struct GroundFunction {
  const GroundSurface* surface = nullptr;  // Null: level.
  double level_m = 0.0;                    // Without a surface, and where it is not known.

  double operator()(const Eigen::Matrix<double, 2, 1>& x) const {
    return surface == nullptr ? level_m : surface->ElevationAt(x).value_or(level_m);
  }
  template <typename T>
  T operator()(const Eigen::Matrix<T, 2, 1>& x) const {
    const Eigen::Vector2d at(x(0).a, x(1).a);
    if (surface == nullptr || surface->spacing() == 0.0) return T((*this)(at));
    const double step = 0.5 * surface->spacing();
    const Eigen::Vector2d slope(
        ((*this)(Eigen::Vector2d(at.x() + step, at.y())) - (*this)(Eigen::Vector2d(at.x() - step, at.y()))) / (2.0 * step),
        ((*this)(Eigen::Vector2d(at.x(), at.y() + step)) - (*this)(Eigen::Vector2d(at.x(), at.y() - step))) / (2.0 * step));
    return (*this)(at) + slope.x() * (x(0) - at.x()) + slope.y() * (x(1) - at.y());
  }
};

// How a frame sees a world point, for frames with a camera: p = {dx, dy, dz, rotation vector}.
struct CameraProjection {
  Camera camera;  // Current value.
  SensorFrame sensor;
  GroundFunction ground;

  template <typename T>
  bool operator()(const T* p, const T* lens, const Eigen::Matrix<T, 2, 1>& x, Eigen::Matrix<T, 2, 1>* u) const {
    return See<T>(p, lens, Eigen::Matrix<T, 3, 1>(x(0), x(1), ground(x)), u);
  }
  // A point off the ground surface.
  template <typename T>
  bool See(const T* p, const T* lens, const Eigen::Matrix<T, 3, 1>& x, Eigen::Matrix<T, 2, 1>* u) const {
    using std::exp;
    const Eigen::Matrix<T, 3, 1> offset(x(0) - camera.position_m.x() - p[0], x(1) - camera.position_m.y() - p[1],
                                        x(2) - camera.position_m.z() - p[2]);
    const Eigen::Matrix<T, 3, 1> unrotated = camera.world_from_camera.transpose().cast<T>() * offset;
    const T inverse_rotation[3] = {-p[3], -p[4], -p[5]};
    T ray[3];
    ceres::AngleAxisRotatePoint(inverse_rotation, unrotated.data(), ray);
    if (!(ray[2] > 1e-6)) return false;
    const T a = ray[0] / ray[2], b = ray[1] / ray[2];
    const T focal_px = camera.focal_px * exp(lens[0]) * (1.0 + lens[1] * (a * a + b * b));
    *u << sensor.centre_x + focal_px * a, sensor.centre_y + focal_px * b;
    return true;
  }
};

// The same for frames with a free homography.
struct FreeProjection {
  Eigen::Matrix3d unit_from_world = Eigen::Matrix3d::Identity();  // Current value, positive third coordinate on the visible ground.
  SensorFrame sensor;

  template <typename T>
  bool operator()(const T* d, const T* /*lens*/, const Eigen::Matrix<T, 2, 1>& x, Eigen::Matrix<T, 2, 1>* u) const {
    const Eigen::Matrix<T, 3, 1> world(x(0), x(1), T(1.0));
    const Eigen::Matrix<T, 3, 1> unit = ApplyDelta<T>(d, unit_from_world.cast<T>() * world);
    if (!(unit(2) > 1e-9)) return false;
    *u << sensor.centre_x + sensor.half_px * unit(0) / unit(2), sensor.centre_y + sensor.half_px * unit(1) / unit(2);
    return true;
  }
  // A free map knows no heights.
  template <typename T>
  bool See(const T* d, const T* lens, const Eigen::Matrix<T, 3, 1>& x, Eigen::Matrix<T, 2, 1>* u) const {
    return (*this)(d, lens, Eigen::Matrix<T, 2, 1>(x.template head<2>()), u);
  }
};

using Whitener8 = Eigen::Matrix<double, 8, 8>;

// Whitens the residuals of the four tie points: inverse Cholesky factor of J C J' + floor^2 I. C 6 x 6: J is the affine map from the upper
// left, upper right and lower left corners to the points; 8 x 8: the bilinear one from all four.
Whitener8 TieWhitener(const CornerCovariance& corner_covariance_px2, double floor_px);

// Where a frame sees the scene's points against where the chain says it sees them: 4 tie points, 8 whitened residuals.
template <typename Projection>
struct TieResidual {
  Projection projection;
  Eigen::Matrix3d world_from_unit;
  std::array<Eigen::Vector2d, 4> xi;
  std::array<Eigen::Vector2d, 4> u;
  Whitener8 whitener;
  // The view is affine and knows nothing of the displacement that no affine map makes (+, -, +, - round the four points): of a camera,
  // whose perspective is known, that part is left out.
  bool affine_part = false;

  template <typename T>
  bool operator()(const T* frame, const T* scene, const T* lens, T* residuals) const {
    Eigen::Matrix<T, 8, 1> error;
    for (int k = 0; k < 4; ++k) {
      Eigen::Matrix<T, 2, 1> x;
      Eigen::Matrix<T, 2, 1> seen;
      const auto point = static_cast<std::size_t>(k);
      if (!WorldFromUnit(world_from_unit, scene, xi[point], &x) || !projection(frame, lens, x, &seen)) return false;
      error.template segment<2>(2 * k) = seen - u[point].cast<T>();
    }
    for (int axis = 0; axis < 2 && affine_part; ++axis) {
      const T twist = 0.25 * (error(axis) - error(2 + axis) + error(4 + axis) - error(6 + axis));
      for (int k = 0; k < 4; ++k) error(2 * k + axis) -= k % 2 == 0 ? twist : -twist;
    }
    Eigen::Map<Eigen::Matrix<T, 8, 1>> out(residuals);
    out = whitener.cast<T>() * error;
    return true;
  }
};

// A surveyed point against where a frame shows it: 2 residuals, in units of `sigma_px`.
template <typename Projection>
struct ControlResidual {
  Projection projection;
  Eigen::Vector3d x_in_world;
  Eigen::Vector2d u;
  double sigma_px = 1.0;

  template <typename T>
  bool operator()(const T* frame, const T* lens, T* residuals) const {
    Eigen::Matrix<T, 2, 1> seen;
    if (!projection.template See<T>(frame, lens, x_in_world.cast<T>(), &seen)) return false;
    residuals[0] = (seen(0) - u.x()) / sigma_px;
    residuals[1] = (seen(1) - u.y()) / sigma_px;
    return true;
  }
};

// One point seen in two scenes, in units of its standard deviation.
struct ContentResidual {
  Eigen::Matrix3d world_from_unit_a;
  Eigen::Matrix3d world_from_unit_b;
  Eigen::Vector2d xi_a;
  Eigen::Vector2d xi_b;
  Eigen::Matrix2d whitened_from_world;

  template <typename T>
  bool operator()(const T* a, const T* b, T* residuals) const {
    Eigen::Matrix<T, 2, 1> x_a;
    Eigen::Matrix<T, 2, 1> x_b;
    if (!WorldFromUnit(world_from_unit_a, a, xi_a, &x_a) || !WorldFromUnit(world_from_unit_b, b, xi_b, &x_b)) return false;
    Eigen::Map<Eigen::Matrix<T, 2, 1>> out(residuals);
    out = whitened_from_world.cast<T>() * (x_a - x_b);
    return true;
  }
};

// A camera's deviation from its telemetry, less the shared errors of position [m] and attitude [rad]: 6 residuals.
struct CameraPrior {
  Eigen::Vector3d position_offset_m;   // Current position minus telemetry's.
  Eigen::Quaterniond camera_rotation;  // telemetry_camera_from_current_camera.
  double position_sigma_m = 1.0;
  double attitude_sigma_rad = 1.0;

  template <typename T>
  bool operator()(const T* p, const T* position_bias, const T* attitude_bias, T* residuals) const {
    T step[4];
    ceres::AngleAxisToQuaternion(p + 3, step);
    const T current[4] = {T(camera_rotation.w()), T(camera_rotation.x()), T(camera_rotation.y()), T(camera_rotation.z())};
    T total[4];
    ceres::QuaternionProduct(current, step, total);
    T angle[3];
    ceres::QuaternionToAngleAxis(total, angle);
    for (int k = 0; k < 3; ++k) {
      residuals[k] = (position_offset_m(k) + p[k] - position_bias[k]) / position_sigma_m;
      residuals[3 + k] = (angle[k] - attitude_bias[k]) / attitude_sigma_rad;
    }
    return true;
  }
};

// Image corners whose ground positions telemetry gives: 8 residuals, sensor px / sigma.
struct CornerPrior {
  FreeProjection projection;
  std::array<Eigen::Vector2d, 4> x_in_world;
  std::array<Eigen::Vector2d, 4> u;
  double sigma_px = 1.0;

  template <typename T>
  bool operator()(const T* d, const T* position_bias, T* residuals) const {
    for (int k = 0; k < 4; ++k) {
      const auto point = static_cast<std::size_t>(k);
      const Eigen::Matrix<T, 2, 1> x(x_in_world[point].x() + position_bias[0], x_in_world[point].y() + position_bias[1]);
      Eigen::Matrix<T, 2, 1> seen;
      if (!projection(d, static_cast<const T*>(nullptr), x, &seen)) return false;
      residuals[2 * k] = (seen(0) - u[point].x()) / sigma_px;
      residuals[2 * k + 1] = (seen(1) - u[point].y()) / sigma_px;
    }
    return true;
  }
};

// Keeps a free frame without telemetry from running away along what ties hardly see: its perspective (change of scale from the image's
// centre to its edge) and its scale against the chain's. Weak beside any tie.
struct ShapePrior {
  Eigen::Matrix3d unit_from_world;
  double log_scale0 = 0.0;  // Log of the world's length of one half image.
  double perspective_sigma = 0.1;
  double log_scale_sigma = 0.3;

  template <typename T>
  bool operator()(const T* d, T* residuals) const {
    using std::abs;
    using std::log;
    Eigen::Matrix<T, 3, 3> delta;
    delta << 1.0 + d[0], d[1], d[2], d[3], 1.0 + d[4], d[5], d[6], d[7], T(1.0);
    const Eigen::Matrix<T, 3, 3> map = delta * unit_from_world.cast<T>();
    // Rows of the adjugate give world_from_unit up to scale.
    const Eigen::Matrix<T, 3, 1> c0 = map.col(1).cross(map.col(2));
    const Eigen::Matrix<T, 3, 1> c1 = map.col(2).cross(map.col(0));
    const Eigen::Matrix<T, 3, 1> c2 = map.col(0).cross(map.col(1));
    if (abs(c2(2)) < 1e-12) return false;
    const T g20 = c2(0) / c2(2);
    const T g21 = c2(1) / c2(2);
    const T x = c0(2) / c2(2), y = c1(2) / c2(2);
    const T j00 = c0(0) / c2(2) - x * g20, j01 = c0(1) / c2(2) - x * g21;
    const T j10 = c1(0) / c2(2) - y * g20, j11 = c1(1) / c2(2) - y * g21;
    const T area = abs(j00 * j11 - j01 * j10);
    if (!(area > 0.0)) return false;
    residuals[0] = g20 / perspective_sigma;
    residuals[1] = g21 / perspective_sigma;
    residuals[2] = (0.5 * log(area) - log_scale0) / log_scale_sigma;
    return true;
  }
};

}  // namespace trem::align
