#pragma once

#include <vector>

#include "mosaic/base/image.h"
#include "mosaic/geometry/roi.h"
#include "worker/tre/frame_residual.h"

namespace trem {

// Finds what moves in a scene, so that it neither blurs the scene nor bends the registration, and what stood in the scene when it was
// begun.
//
// A pixel is masked when the residuals about it (3 x 3) are more than noise and model error explain, several of them together: single
// outliers are Huber's business, and a bad pixel's. Over a block of the scene (`ratio` x `ratio` cells, about a sensor pixel) that was
// masked a frame ago less is enough (hysteresis). A block that frame after frame contradicts in the same way, more often than it had been
// seen before, is outvoted: its scene, and not the frames, shows the mover, and has to be made anew. A frame of which a large part would be
// masked is not a frame with a mover: nothing is masked then.
class MoverMask {
 public:
  explicit MoverMask(int ratio) : ratio_(ratio) {}

  // Before registration: sets the weights of pixels that `view` puts onto blocks masked in the frame before to 0 (an empty image means all
  // 1). Returns whether there are any.
  bool Hide(const View& view, const Roi& roi, Image<float>* weights) const;
  // After it: judges every pixel. Afterwards mask() and outvoted() are this frame's; they do not depend on `threads`.
  void Judge(const FrameResidual& residual, const View& view, const Roi& roi, double noise_sigma, int threads);

  // 1: masked; size of the ROI.
  const Image<unsigned char>& mask() const { return mask_; }
  long long masked_count() const { return masked_count_; }
  // Blocks (x, y) whose cells [ratio x, ratio x + ratio) x ... of the scene plane are to be made anew.
  struct Block {
    int x = 0;
    int y = 0;
  };
  const std::vector<Block>& outvoted() const { return outvoted_; }
  // Whether a cell of the scene plane is in one of them.
  bool IsOutvoted(const Eigen::Vector2d& cell) const;

 private:
  struct State {
    float mean = 0.0F;         // Of the residuals that contradict the scene, scene grey levels.
    unsigned char count = 0;   // Frames in a row that contradict in the same way.
    unsigned char hidden = 0;  // 1: masked in the last frame, or beside such a block.
    unsigned char stamp = 0;   // Of the frame that touched it last.
    unsigned char anew = 0;    // Stamp of the frame that outvoted it.
  };

  // Of a row of pixels: sum of min(excess, kSmallExcess), and how many have one.
  struct RowSum {
    float small = 0.0F;
    float pixels = 0.0F;
  };

  void Cover(const View& view, const Roi& roi);
  // Of the block that holds a cell, in blocks_; -1: not in memory.
  int IndexAt(float cell_x, float cell_y) const;
  // The excess of every pixel, summed along a row; scores from the sums of three rows; both for all rows.
  void SumRow(const FrameResidual& residual, int v);
  void ScoreRow(int v, float misfit);
  void SumUp(const FrameResidual& residual, int threads);
  void Flag(const View& view, const Roi& roi);
  void Vote(const FrameResidual& residual, const View& view, const Roi& roi, double noise_sigma);
  void Dilate();
  void SpreadHidden();

  int ratio_;
  Roi extent_;  // Of blocks_, in blocks of the scene plane.
  Image<State> blocks_;
  Image<float> excess_;  // Squared residual over variance, capped.
  Image<float> known_;   // 1 where there is one.
  Image<float> score_;   // Mean of excess_ over 3 x 3.
  std::vector<RowSum> row_sums_;
  Image<unsigned char> flagged_;
  Image<unsigned char> mask_;
  std::vector<Block> outvoted_;
  long long flagged_count_ = 0;
  long long masked_count_ = 0;
  unsigned char stamp_ = 0;
  bool any_hidden_ = false;
};

}  // namespace trem
