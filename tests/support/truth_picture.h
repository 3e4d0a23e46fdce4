#pragma once

#include <string>

#include "mosaic/base/image.h"

namespace trem::testing {

// The part of `path` (anything OpenCV reads, as grey levels 0..255) of width x height pixels whose upper left one is (x, y). An empty
// image when the file cannot be read or is too small, with a message on stderr.
Image<float> ReadTruthPicture(const std::string& path, int x, int y, int width, int height);

}  // namespace trem::testing
