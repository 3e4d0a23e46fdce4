#pragma once

#include <vector>

#include "mosaic/base/image.h"

namespace trem {

// A place in a frame that looks like a picture.
struct Sighting {
  int x = 0;  // Frame pixel under the picture's upper left pixel.
  int y = 0;
  double correlation = 0.0;  // Normalised cross correlation, -1..1: blind to gain and offset.
};

// The places of `frame` that look most like `picture`, best first, at most `count_max`, no two of them closer than half the picture's
// sides. Pixels of the picture that are NaN are not compared; pixels of the frame that are NaN count as the frame's mean. Nothing when
// the picture does not fit into the frame or has no texture. Cost: a few FFTs of the frame.
std::vector<Sighting> FindPicture(const Image<float>& picture, const Image<float>& frame, int count_max);

}  // namespace trem
