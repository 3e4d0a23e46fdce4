#pragma once

#include "mosaic/base/image.h"

namespace trem {

// Where a row of a frame's pixels lies in a scene buffer: pixel u at (x + u * dx, y + u * dy) / (depth + u * d_depth) [cells of the
// buffer]. Pixels at depths that are not positive lie behind the horizon and are left out.
struct SplatRow {
  const float* pixels = nullptr;   // NaN: no measurement.
  const float* weights = nullptr;  // Relative inverse variance; null: all 1. A pixel without a positive one is left out.
  int begin = 0;                   // Pixels [begin, end) are looked at, and a few before them.
  int end = 0;
  double x = 0.0;
  double y = 0.0;
  double dx = 0.0;
  double dy = 0.0;
  double depth = 1.0;
  double d_depth = 0.0;
};

// pixel = gain * scene + offset; residuals [grey levels] beyond `limit` lose weight.
struct SplatModel {
  float gain = 1.0F;
  float offset = 0.0F;
  float limit = 0.0F;
};

// Images of the scene buffer; all of the same size.
struct SplatPlanes {
  const Image<float>* prediction = nullptr;
  const Image<float>* seen = nullptr;
  Image<float>* weight = nullptr;
  Image<float>* weighted = nullptr;
};

// Adds the samples that fall nearest to cells of rows [row_begin, row_end) to these cells; see InformationUpdate::AddFrame. The prediction
// is sampled by Keys' bicubic at the pixel's place, so the sample is carried to the cell's centre along the model's own slope. The bytes do
// not depend on the vectors' length. One load of four cells per row of the 4 x 4 support is cheaper than any gather.
void Splat(const SplatRow& row, const SplatModel& model, int row_begin, int row_end, const SplatPlanes& planes);

}  // namespace trem
