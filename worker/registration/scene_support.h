#pragma once

#include <Eigen/Core>

#include "worker/registration/target.h"
#include "worker/registration/view.h"

namespace trem {

// How well the scene behind a frame's pixels is known: over the pixels used, with n the frames that have seen the cell under each.
struct SceneSupport {
  // sum w^2 / sum w of the weights w = n / (n + 1): the frame's own share of the error variance that weighted least squares reports.
  // That counts the scene's noise (1 / n a cell) as if it were new in every frame; it is not, see worker/tre/place_field.h.
  double own_share = 1.0;
};

// Every fourth pixel of every fourth row.
SceneSupport MeasureSupport(const Observation& observation, const Reference& reference, const View& view);

}  // namespace trem
