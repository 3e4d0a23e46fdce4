#pragma once

#include <Eigen/Core>
#include <vector>

#include "mosaic/geometry/planar_map.h"
#include "mosaic/geometry/roi.h"
#include "worker/registration/target.h"
#include "worker/registration/view.h"

namespace trem {

// How far from its true place the scene lies on its plane, as a Gaussian random field: one error e_b [cells] for each block of a quarter
// of the ROI's sides, with the covariance of all of them.
//
// A frame's noise, projected on what moving a block would change, is a score s_b ~ N(0, c_b (a G_b + p^2 K_b)): c_b the frame's pixels on
// the block, G_b a pixel's information of its place (g g' / sigma^2 [1/cells^2], g the gradient), K_b = |g|^2 / sigma^2 times it for what a
// sample is off beside its noise, a and p calibrated. Linearised, with J_b what a corner displacement d moves
// block b by and r_b its pixels' weights in the registration,
//
//   d = d_e - d_s,   d_e = (A + L)^-1 sum_b r_b J_b' G_b e_b,   d_s = (A + L)^-1 sum_b (r_b / c_b) J_b' s_b,   A = sum_b r_b J_b' G_b J_b
//
// is the error of the frame's view against the first frame's plane: that of the scene beneath it, less that of its own noise. Written into
// the scene at this view, the frame leaves
//
//   n_b <- gamma n_b + c_b,   n_b e_b <- gamma n_b e_b + G_b^-1 s_b + c_b J_b d
//
// So noise that an affine (projective) map explains leaves no trace where all blocks are equally old, the first frame's excepted, which
// stays as an error common to all; and where ground is new, what each frame's noise does to it stays and is passed on. The state is
// y_b = G_b e_b, which is known where G_b is singular too.
class PlaceField {
 public:
  // `roi`: of the sensor; its size is that of all frames' ROIs.
  PlaceField(const Roi& roi, int ratio, ViewModel model);

  // What a frame's pixels say of the blocks beneath them, from the reference's gradients.
  struct BlockTexture {
    int x = 0;  // Block (x, y) holds the cells from (x, y) * block size.
    int y = 0;
    double pixels = 0.0;                                    // c_b.
    double registered = 0.0;                                // r_b: weight n / (n + 1) of those on cells seen n >= reference.seen_min times.
    Eigen::Vector2d centre = Eigen::Vector2d::Zero();       // Of the pixels, sensor px.
    Eigen::Matrix2d information = Eigen::Matrix2d::Zero();  // G_b.
    Eigen::Matrix2d contrast = Eigen::Matrix2d::Zero();     // K_b.
  };
  using Texture = std::vector<BlockTexture>;
  Texture Measure(const Observation& observation, const Reference& reference, const View& view) const;

  // The covariance of d_e: what the scene adds to the covariance of a view that was registered to it.
  CornerMatrix CovarianceOf(const Texture& texture, const Observation& observation, const View& view) const;
  // A frame was written into the scene at `view`; `before` and `after` are its textures before and after that. The first one's view is
  // exact.
  void Add(const Texture& before, const Texture& after, const Observation& observation, const View& view, double forgetting);
  // Forgets blocks that `extent` (cells) does not touch.
  void Keep(const Roi& extent);
  void Clear();

 private:
  struct Block {
    int x = 0;
    int y = 0;
    double pixels = 0.0;                                    // n_b.
    Eigen::Matrix2d information = Eigen::Matrix2d::Zero();  // G_b.
  };
  using Matrix = Eigen::MatrixXd;
  // d_e = gain * y.
  struct Fit {
    CornerMatrix inverse;  // (A + L)^-1.
    Matrix gain;
  };
  Fit FitOf(const Texture& texture, const Observation& observation, const View& view) const;
  // J_b.
  Eigen::Matrix<double, 2, Eigen::Dynamic, 0, 2, 8> Motion(const BlockTexture& block, const Roi& roi, const View& view) const;
  // Index in `blocks_`; -1: none.
  Eigen::Index Find(int x, int y) const;

  ViewModel model_;
  double block_width_;  // Cells.
  double block_height_;
  int stride_;  // Every so manieth pixel of every so manieth row is looked at.
  std::vector<Block> blocks_;
  Matrix covariance_;  // Of y, 2 a block.
};

}  // namespace trem
