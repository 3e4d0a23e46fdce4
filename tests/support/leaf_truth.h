#pragma once

#include <cstdint>

#include "mosaic/base/image.h"

namespace trem::testing {

// Discs of random grey, 40..215, whose radii have the density r^-3 between 1.5 and 150 cells, each over the ones before: the model whose
// power spectrum is that of natural pictures (A. B. Lee, D. Mumford, J. Huang, Occlusion models for natural images, Int. J. Computer
// Vision 41, 2001).
Image<float> LeafTruth(int width, int height, std::uint64_t seed);

}  // namespace trem::testing
