#pragma once

#include <Eigen/Core>

#include "worker/registration/target.h"
#include "worker/registration/view.h"

namespace trem {

// How well the scene behind a frame's pixels is known: over the pixels used, with n the frames that have seen the cell under each.
struct SceneSupport {
  // sum w^2 / sum w of the weights w = n / (n + 1): the frame's own share of the error variance that weighted least squares reports.
  // That counts the scene's noise (1 / n a cell) as if it were new in every frame; it is not, see worker/tre/segment.h.
  double own_share = 1.0;
  // What writing the frame into the scene, 1 / n a cell, moves the scene's place by where cells are not all as old: covariance over the
  // corners (ul, ur, ll, lr; of an affine view the first three) of one coordinate, per unit of the mean variance of a corner coordinate of
  // the frame's own place. With q the corners' weights at a pixel and sums over pixels, M0 = sum q q', M1 = sum q q' / n,
  // M2 = sum q q' / n^2: M0^-1 (M2 - M1 M0^-1 M1) M0^-1 / mean diagonal of M0^-1; texture is taken to be even.
  Eigen::Matrix4d unevenness = Eigen::Matrix4d::Zero();
};

// Every fourth pixel of every fourth row.
SceneSupport MeasureSupport(const Observation& observation, const Reference& reference, const View& view, ViewModel model);

}  // namespace trem
