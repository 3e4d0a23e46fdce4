#pragma once

#include "mosaic/base/image.h"

namespace trem {

// Half-size image of 2x2 means (an odd last row or column is dropped). Pixel k of the result is centred at 2 k + 1/2 of the input.
// NaN if any of the four is NaN.
Image<float> ReduceByTwo(const Image<float>& image);
// A frame with the relative inverse variance of its pixels.
struct WeightedImage {
  Image<float> pixels;
  Image<float> weights;
};

// Half-size image of weighted means; NaN pixels have no weight. `weights` null: all 1. A result's weight is the mean of the four, so that
// it stays relative to a block of whole ones; blocks with less than half of their largest weight's four are left out (weight 0, pixel 0),
// because a mean of so few is not centred on the block.
WeightedImage ReduceByTwoWeighted(const Image<float>& image, const Image<float>* weights);
// The same as ReduceByTwo with the minimum of the four.
Image<float> ReduceByTwoMinimum(const Image<float>& image);

}  // namespace trem
