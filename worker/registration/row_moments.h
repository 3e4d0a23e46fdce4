#pragma once

#include <cstddef>
#include <vector>

namespace trem {

// Sums over the pixels of one row of products of the prediction's gradient (gx, gy) [grey levels per sensor px], its value P, 1 and the
// residual r, times powers of the coordinate s along the row and the pixel's weight w. A row of Gauss-Newton's normal equations is
// assembled from them (worker/registration/normal_equations.h). k counts the power of s.
enum Moment : int {
  kXX = 0,   // w gx gx s^k, k = 0..4
  kXY = 5,   // w gx gy s^k, k = 0..3
  kYY = 9,   // w gy gy s^k, k = 0..2
  kXP = 12,  // w gx P s^k, k = 0..2
  kYP = 15,  // w gy P s^k, k = 0..1
  kX1 = 17,  // w gx s^k, k = 0..2
  kY1 = 20,  // w gy s^k, k = 0..1
  kXR = 22,  // w gx r s^k, k = 0..2
  kYR = 25,  // w gy r s^k, k = 0..1
  kPP = 27,
  kP1 = 28,
  k11 = 29,
  kPR = 30,
  k1R = 31,
  kRR = 32,
  kSeen = 33,   // Weight before the robust factor.
  kCount = 34,  // Used pixels.
  kMomentCount = 36,
};

// One row of one resolution level under one view. Pixel i of the row, i = 0 .. count - 1, is taken at the prediction's pixel
//
//   (x, y) = ((nx0 + nx1 i) / D, (ny0 + ny1 i) / D),   D = d0 + d1 i   (affine views: d0 = 1, d1 = 0)
//
// relative to `prediction` and `seen`, which point near the middle of the row's track, so that float holds x and y to 1e-4 px.
struct MomentRow {
  const float* pixels = nullptr;   // Of the frame; NaN or infinite: no measurement.
  const float* weights = nullptr;  // Null: all 1.
  int pixel_step = 1;              // Pixel i is pixels[i * pixel_step].
  int count = 0;
  const float* prediction = nullptr;
  const float* seen = nullptr;
  std::ptrdiff_t stride = 0;  // Of the prediction and of `seen`.
  float nx0 = 0.0F, nx1 = 0.0F, ny0 = 0.0F, ny1 = 0.0F, d0 = 1.0F, d1 = 0.0F;
  // Samples are taken where x_min <= x < x_max, y_min <= y < y_max: the 4 x 4 support lies in the image there.
  float x_min = 0.0F, x_max = 0.0F, y_min = 0.0F, y_max = 0.0F;
  // gx = (dx (ax - x bx) + dy (ay - y bx)) / D, gy = (dx (cx - x by) + dy (cy - y by)) / D, dx, dy the prediction's gradient per pixel.
  float ax = 0.0F, ay = 0.0F, cx = 0.0F, cy = 0.0F, bx = 0.0F, by = 0.0F;
  float s0 = 0.0F, s1 = 0.0F;  // s = s0 + s1 i.
  float seen_min = 0.0F;
  float gain = 1.0F, offset = 0.0F;
  float huber = 0.0F;  // |r| from which the robust weight is huber / |r|, grey levels.
};

// Scratch memory of a row; after RowMoments the used pixels' |r|.
struct MomentScratch {
  void Reserve(int count);
  std::vector<float> x_fraction, seen, pixel, trust, residual;
  std::vector<float> y_weights, y_slopes;  // 4 a pixel.
  std::vector<float> values, slopes;       // 4 a pixel: columns of the 4 x 4 support combined along y.
  std::vector<int> index;                  // Of the support's first pixel.
  std::vector<int> nearest;                // Of the nearest pixel.
};

// Adds nothing: overwrites moments[0 .. kMomentCount). `projective`: with the powers of s that only projective views need (else those
// moments are 0). On return scratch->residual[i] is |r|, or -1 where the pixel was not used. The bytes do not depend on the instruction
// set: 16 lanes of float sums whatever the vector's length, no fused multiply-add.
void RowMoments(const MomentRow& row, bool projective, MomentScratch* scratch, float* moments);

}  // namespace trem
