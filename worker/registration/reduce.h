#pragma once

#include "mosaic/base/image.h"

namespace trem {

// Half-size image of 2x2 means (an odd last row or column is dropped). Pixel k of the result is centred at 2 k + 1/2 of the input.
// NaN if any of the four is NaN.
Image<float> ReduceByTwo(const Image<float>& image);
// The same with the minimum of the four.
Image<float> ReduceByTwoMinimum(const Image<float>& image);

}  // namespace trem
