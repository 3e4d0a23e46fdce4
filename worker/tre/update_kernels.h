#pragma once

#include "worker/sensor/filter_rows.h"

namespace trem {

// Row kernels of one step of the scene update, vectorised with run-time dispatch. Scratch rows ("line") have kRowSlack floats beyond the
// last one in use; rows of images are read and written within [0, count) only. The order of operations for a cell is fixed, so its value
// depends neither on the vector's width nor on how a region is cut into tiles.

// line[x] = w[x] * predicted[x] - z[x]; rows of images.
void ResidualRow(const float* predicted, const float* w, const float* z, int count, float* line);

// Rows of the residual: out[i][x] = w[i][x] * filtered - z[i][x], row i of `block` filtered. Pointers are to column 0 of the image; `w` and
// `z` are rows of images, `out` lines.
void ResidualRows(const FilterBlock& block, const float* const* w, const float* const* z, float* const* out);

// One row of the step that follows; pointers are to column 0 of the image.
struct StepRow {
  const float* start = nullptr;  // Line: the scene that the step begins with, one cell to either side of the block's columns, too.
  const float* above = nullptr;  // Its rows above and below; `start` itself at the region's border.
  const float* below = nullptr;
  const float* majoriser = nullptr;  // Row of an image.
  float* out = nullptr;              // Line: what the step makes of it.
  const float* previous = nullptr;   // Line or row of an image: what the step before this one made.
  float* next_start = nullptr;       // Line: what the step after this one begins with, out + momentum * (out - previous).
};

struct StepWeights {
  float lambda = 0.0F;   // Of the structure prior.
  float limit = 0.0F;    // Difference beyond which its psi' is constant [grey levels].
  float damping = 0.0F;  // Added to the majoriser.
};

// What all rows of a block of steps share.
struct StepBlock {
  const StepRow* rows = nullptr;
  StepWeights weights;
  int left_border = -1;   // Column that is the region's first, it has no difference to its left; -1: none of them.
  int right_border = -1;  // Its last.
  float momentum = 0.0F;
};

// out = start - (B residual + lambda * sum over 4 neighbours of clamp(start - neighbour, limit)) / (majoriser + damping), row i of `block`
// being B residual.
void StepRows(const FilterBlock& block, const StepBlock& step);

// row[x] *= factor; a row of an image.
void ScaleRow(float factor, int count, float* row);

// A row of a frame's pixels laid over images of a scene buffer: pixel i is at ((x + dx i) s - left, (y + dy i) s - top) [cells of the
// buffer], s = 1 / (depth + d_depth i), or 1 when `affine`.
struct OverlaidRow {
  const float* prediction = nullptr;  // height x width.
  const float* seen = nullptr;        // height x width.
  int width = 0;
  int height = 0;
  float x = 0.0F, y = 0.0F, depth = 1.0F;
  float dx = 0.0F, dy = 0.0F, d_depth = 0.0F;
  float left = 0.0F, top = 0.0F;
  bool affine = true;
  float seen_min = 0.0F;
  float gain = 1.0F, offset = 0.0F;
};
// predicted[i] = gain * prediction + offset, bilinear, and frames[i] the nearest cell's `seen`; NaN and 0 where the pixel leaves the images
// or `seen` is less than seen_min. No fused operations: the same bytes on every processor.
void PredictRow(const OverlaidRow& row, int count, float* predicted, float* frames);

// Least and largest of three rows of images; NaNs take no part, and where there is nothing else they are 1e9 and -1e9. `low` and `high` are
// lines.
void RangeOfRows(const float* const* rows, int count, float* low, float* high);

// One row of what a frame leaves of a prediction; see FrameResidual.
struct ExplainedRow {
  const float* low = nullptr;  // Lines by RangeOfRows, with a value to either side.
  const float* high = nullptr;
  const float* predicted = nullptr;  // Rows of images, like all that follow.
  const float* frames = nullptr;     // That have seen the scene there.
  const float* pixels = nullptr;
  const float* weights = nullptr;  // Null: all 1.
  float noise2 = 0.0F;
  float settled_part = 0.0F;  // Model error as a part of the contrast, and what one frame's adds to it.
  float fresh_part = 0.0F;
  float seen_min = 0.0F;
};
// variance = noise2 (1 / weight + 1 / n) + ((settled_part + fresh_part / n) * contrast)^2, n = max(frames, seen_min), contrast the range
// over 3 x 3 pixels; residual = pixel - predicted, NaN where the weight is 0. No fused operations.
void ExplainRow(const ExplainedRow& row, int count, float* variance, float* residual);

// Index of the first of row[0 .. count) that is not `value`; `count` when there is none. A row of an image.
int FindUnlike(const float* row, float value, int count);

// Sums over the cells of a row that enough frames have seen.
struct TextureSums {
  double size = 0.0;     // Of |right neighbour - cell| + |cell below - cell|.
  double squares = 0.0;  // Of the squares of both.
  double seen = 0.0;     // Of the frames that have seen the cell.
  double count = 0.0;    // Of these cells.
};
// Over cells [0, count), reading row[0 .. count]; cells with seen < seen_min are left out. Eight lanes on every processor: the bytes do not
// depend on it.
TextureSums SumTexture(const float* row, const float* below, const float* seen, float seen_min, int count);

// How InformationUpdate::UpdateSeen judges cells.
struct SeenLimits {
  float many_frames = 0.0F;    // Cells with at least this weight about them ...
  float near_part_min = 0.0F;  // ... count as not seen when less than this part of it lies near.
};

// One row of the count of frames: seen[x] = sum_i (ratio - |i|) * tents[x + i] / ratio^2 over |i| < ratio, and 0 where that is many frames
// but sum of near[x + i] over |i| <= ratio / 2 is too small a part of it. `tents` and `near` are lines with `ratio` cells to either side.
void SeenRow(const float* tents, const float* near, int ratio, const SeenLimits& limits, int count, float* seen);

}  // namespace trem
