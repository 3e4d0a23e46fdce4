#pragma once

#include <Eigen/Core>

#include "mosaic/geometry/planar_map.h"
#include "mosaic/geometry/roi.h"

namespace trem {

// One frame's relation to a scene: frame(u) = gain * scene(scene_from_sensor * u) + offset, u in sensor pixels of the whole image.
struct View {
  PlanarMap scene_from_sensor;
  double gain = 1.0;
  double offset = 0.0;
};

// How many parameters the geometry of a view has.
enum class ViewModel {
  kAffine,      // 6: enough for a ROI of 151 x 151 px at fields of view up to about 4 degrees.
  kProjective,  // 8: wide fields of view, large ROIs, oblique views.
};

// The parameters of a view as displacements [sensor px] of the ROI's corner pixel centres. Affine: upper left, upper right and lower
// left, d = (ul.x, ul.y, ur.x, ur.y, ll.x, ll.y). Projective: the lower right one as well. The size of the vector, 6 or 8, is the
// model. One isotropic step suits all of them, whatever the ROI's size.
//
// A displacement moves where a ROI corner is seen in the scene: M(d)(u) = M(W_d(u)), W_d the affine map or the homography of the sensor
// plane that takes each corner to its displaced place. Affine: W_d(u) = u + sum_k w_k(u) d_k, w the barycentric weights of u.
using CornerVector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, 8, 1>;
using CornerMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 8, 8>;

constexpr int ParameterCount(ViewModel model) { return model == ViewModel::kProjective ? 8 : 6; }
constexpr ViewModel ModelOf(Eigen::Index parameter_count) { return parameter_count == 8 ? ViewModel::kProjective : ViewModel::kAffine; }

// The three barycentric weights (ul, ur, ll) of sensor point `u`; they sum to 1.
Eigen::Vector3d CornerWeights(const Roi& roi, const Eigen::Vector2d& u);

// d W_d(u) / d d at d = 0, 2 x 6 or 2 x 8. Projective: with s, t the coordinates of u along the ROI's width w and height h (0..1),
// sigma = (1, -1, -1, 1) over (ul, ur, ll, lr), and barycentric weights w_k (0 for lr),
//
//   dW / d d_k.x = (w_k + sigma_k s t, -sigma_k (h / w) t (1 - t)),   dW / d d_k.y = (-sigma_k (w / h) s (1 - s), w_k + sigma_k s t)
Eigen::Matrix<double, 2, Eigen::Dynamic, 0, 2, 8> CornerJacobian(const Roi& roi, const Eigen::Vector2d& u, ViewModel model);

// scene_from_sensor composed with the sensor-space map that moves the corners by `d` (6 or 8). A projective displacement that folds the
// ROI (its corners no longer convex) gives a map that is not finite or turns over inside the ROI.
PlanarMap Displace(const PlanarMap& scene_from_sensor, const Roi& roi, const CornerVector& d);

// The displacement that turns `from` into `to`: Displace(from, roi, result) == to, exactly when the maps differ by no more than `model`
// has; else the first three corners agree.
CornerVector CornerDisplacement(const PlanarMap& from, const PlanarMap& to, const Roi& roi, ViewModel model = ViewModel::kAffine);

// Largest displacement [sensor px] of any of the ROI's four corners between the two maps.
double LargestCornerMotion(const PlanarMap& a, const PlanarMap& b, const Roi& roi);

}  // namespace trem
