#pragma once

#include <Eigen/Core>

#include "mosaic/geometry/affine.h"
#include "mosaic/geometry/roi.h"

namespace trem {

// One frame's relation to a scene: frame(u) = gain * scene(scene_from_sensor * u) + offset, u in sensor pixels of the whole image.
struct View {
  Affine scene_from_sensor;
  double gain = 1.0;
  double offset = 0.0;
};

// The six parameters of a view as displacements [sensor px] of the ROI's upper left, upper right and lower left pixel centres:
// d = (ul.x, ul.y, ur.x, ur.y, ll.x, ll.y). One isotropic step suits all six, whatever the ROI's size.
//
// A displacement moves where a ROI corner is seen in the scene: M(d)(u) = M(u + sum_k w_k(u) d_k), w the barycentric weights of u with
// respect to the three corners.
using CornerVector = Eigen::Matrix<double, 6, 1>;
using CornerMatrix = Eigen::Matrix<double, 6, 6>;

// The three barycentric weights (ul, ur, ll) of sensor point `u`; they sum to 1.
Eigen::Vector3d CornerWeights(const Roi& roi, const Eigen::Vector2d& u);

// scene_from_sensor composed with the sensor-space affine map that moves the corners by `d`.
Affine Displace(const Affine& scene_from_sensor, const Roi& roi, const CornerVector& d);

// The displacement that turns `from` into `to`: Displace(from, roi, result) == to.
CornerVector CornerDisplacement(const Affine& from, const Affine& to, const Roi& roi);

// Largest displacement [sensor px] of any of the ROI's four corners between the two maps.
double LargestCornerMotion(const Affine& a, const Affine& b, const Roi& roi);

}  // namespace trem
