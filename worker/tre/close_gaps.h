#pragma once

#include <algorithm>

#include "mosaic/base/image.h"

namespace trem {

// `seen` with the gaps closed that are narrower than a sensor pixel (`ratio` cells): a cell below `seen_min` between two cells along its
// row or column that are not, fewer than `ratio` cells apart from end to end, gets the lesser of the two. Where a camera stands still over
// ground that turns or stretches a little, samples leave lines of cells out; the scene is determined there from both sides. A cell at the
// outer border has neighbours on one side only and stays as it is.
inline Image<float> CloseGaps(const Image<float>& seen, float seen_min, int ratio) {
  Image<float> closed = seen;
  const auto value = [&](int x, int y) { return x >= 0 && y >= 0 && x < seen.width() && y < seen.height() ? seen.at(x, y) : 0.0F; };
  for (int y = 0; y < seen.height(); ++y) {
    for (int x = 0; x < seen.width(); ++x) {
      if (seen.at(x, y) >= seen_min) continue;
      for (int before = 1; before < ratio; ++before) {
        for (int after = 1; before + after <= ratio; ++after) {
          const float across = std::min(value(x - before, y), value(x + after, y));
          const float down = std::min(value(x, y - before), value(x, y + after));
          const float best = std::max(across, down);
          if (best >= seen_min) closed.at(x, y) = std::max(closed.at(x, y), best);
        }
      }
    }
  }
  return closed;
}

}  // namespace trem
