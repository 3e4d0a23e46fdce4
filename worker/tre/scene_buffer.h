#pragma once

#include <algorithm>
#include <vector>

#include "mosaic/base/image.h"
#include "mosaic/geometry/roi.h"

namespace trem {

// The part of a segment's scene plane that is in memory: all images have the same size and cover `extent` [cells of the scene plane].
struct SceneBuffer {
  Roi extent;
  Image<float> scene;       // S, internal grey levels.
  Image<float> previous;    // What the last iteration made, from which Nesterov's momentum has carried S on.
  Image<float> weight;      // W: accumulated weight of the samples splatted to each cell, 1 a sample of unit gain.
  Image<float> weighted;    // Z: accumulated weight * value.
  Image<float> prediction;  // B S, the PSF's radius around what has been iterated included.
  Image<float> filled;      // Where the scene's first value came from: one of the constants below.
  Image<float> majoriser;   // B W: the data term's curvature bound (see InformationUpdate).
  Image<float> seen;        // Weight of the samples within a sensor pixel: about how many frames have seen each cell; 0: none.

  static constexpr float kNotFilled = 0.0F;
  static constexpr float kContinued = 1.0F;  // A frame's border value, continued beyond its ROI.
  static constexpr float kMeasured = 2.0F;   // A frame's own value there.

  // How majoriser and seen stand to W (see InformationUpdate::UpdateSeen).
  struct Count {
    Roi region;          // Of the scene plane: where they have been made. Empty: nowhere, they have to be made anew.
    int frames = 0;      // That have been added since.
    float slack = 0.0F;  // At least what these have added to the majoriser of any cell.
  };
  Count counted;

  // Of a row of `filled`: cells [begin, end) are known to be measured.
  struct Run {
    int begin = 0;
    int end = 0;
  };
  std::vector<Run> measured;  // One a row.

  explicit SceneBuffer(const Roi& extent_in_scene);
  // Cells of the buffer lose all that frames have measured there; the scene keeps what it shows until a frame fills it anew.
  void Forget(const Roi& cells);
  // Moves the extent by whole cells (no resampling); cells that come in are zero with no weight, cells that leave are gone.
  void MoveTo(const Roi& new_extent);
  // `region` of the scene plane in buffer coordinates, clipped to the buffer.
  Roi InBuffer(const Roi& region_in_scene) const;
};

inline Roi Grown(const Roi& roi, int by) { return {roi.x0 - by, roi.y0 - by, roi.x1 + by, roi.y1 + by}; }

// The smallest rectangle that holds both.
inline Roi Union(const Roi& a, const Roi& b) {
  return {std::min(a.x0, b.x0), std::min(a.y0, b.y0), std::max(a.x1, b.x1), std::max(a.y1, b.y1)};
}

}  // namespace trem
