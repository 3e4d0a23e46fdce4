#pragma once

#include "mosaic/base/image.h"
#include "mosaic/geometry/roi.h"

namespace trem {

// The part of a segment's scene plane that is in memory: all images have the same size and cover `extent` [cells of the scene plane].
struct SceneBuffer {
  Roi extent;
  Image<float> scene;        // S, internal grey levels.
  Image<float> previous;     // S before the last iteration (Nesterov's momentum).
  Image<float> weight;       // W: accumulated weight of the samples splatted to each cell, 1 a sample of unit gain.
  Image<float> weighted;     // Z: accumulated weight * value.
  Image<float> prediction;   // B S.
  Image<float> seen;         // ratio^2 * (B W): about how many frames have seen the surroundings of each cell; 0: none.

  explicit SceneBuffer(const Roi& extent_in_scene);
  // Moves the extent by whole cells (no resampling); cells that come in are zero with no weight, cells that leave are gone.
  void MoveTo(const Roi& new_extent);
  // `region` of the scene plane in buffer coordinates, clipped to the buffer.
  Roi InBuffer(const Roi& region_in_scene) const;
};

}  // namespace trem
