#pragma once

#include <vector>

#include "mosaic/base/image.h"
#include "mosaic/geometry/roi.h"

namespace trem {

// Finds the places of a large raster with the most detail while it passes by in rectangles: squares with the largest mean squared
// difference of neighbouring pixels that are covered everywhere and with a margin around them.
class DetailFinder {
 public:
  // `side`: of the squares, pixels, at least 8.
  explicit DetailFinder(int side) : side_(side) {}

  // Adds the pixels of `roi`; NaN: not covered. Squares lie within one rectangle.
  void Add(const Roi& roi, const Image<float>& plane);
  // At most `count` squares, best first, of which no two centres are nearer than two sides.
  std::vector<Roi> Best(int count) const;

 private:
  struct Place {
    double energy = 0.0;
    Roi roi;
  };
  int side_;
  std::vector<Place> places_;  // The best few of each rectangle.
};

}  // namespace trem
