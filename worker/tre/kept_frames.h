#pragma once

#include <cstddef>
#include <deque>
#include <span>
#include <vector>

#include "worker/tre/scene_buffer.h"
#include "worker/tre/update_scheme.h"

namespace trem {

// Samples accumulated about a scene's present prediction P = B S, in two parts that add up. W as in SceneBuffer; Z = W P + C' w r, with r
// the residuals against P where the samples truly lie and C' the adjoint of the bicubic sampling there. So W P - Z is the EXACT slope of
// the data term at S, and only its change with S is that of samples at their nearest cells.
struct Accumulated {
  Image<float> weight;
  Image<float> weighted;
  Image<float> held_weight;  // Of the frames held out; empty: none.
  Image<float> held_weighted;
  std::vector<std::size_t> held;  // Which of frames().
};

// Frames as they were used, so that what was accumulated from them can be made anew about a better scene: while a scene is young, its
// prediction carries samples to the wrong values at their cells and takes sharp detail for outliers. Memory is bounded: the oldest frames
// beyond the bound are added up for good, about the scene of that time.
class KeptFrames {
 public:
  struct Entry {
    KeptFrame frame;
    Roi region;  // Of the scene plane: where the frame before counted `forgetting` times as much from this frame on.
    double forgetting = 1.0;
  };

  // 96 frames of 201 x 201 px with weights are 31 MB.
  static constexpr std::size_t kBytesMax = std::size_t{64} << 20U;

  explicit KeptFrames(double huber_sigmas, int threads, std::size_t bytes_max = kBytesMax)
      : huber_sigmas_(huber_sigmas), threads_(threads), bytes_max_(bytes_max) {}

  // After the frame's samples were added to the buffer.
  void Add(KeptFrame frame, const Roi& region, double forgetting, const SceneBuffer& buffer);
  // Another view of a frame that is kept; nothing happens to others.
  void Revise(int frame_index, const View& view);
  // Drops what is known of `cells` (scene plane): they are to be made from later frames alone.
  void Forget(const Roi& cells);
  // After buffer.MoveTo: frames that no longer reach the buffer are dropped.
  void MoveTo(const Roi& extent);
  std::size_t size() const { return frames_.size(); }
  const Entry& entry(std::size_t index) const { return frames_[index]; }

  // Everything anew about buffer.prediction, frames in the order they came in. Each frame weighs by the spread of its own residuals beside
  // that of the others: what is noisier after a jump of gain, smeared or badly registered counts less. Every `hold_every`-th frame goes to
  // the held-out part; 0: none. Does not depend on the number of threads.
  Accumulated Accumulate(const SceneBuffer& buffer, std::size_t hold_every) const;

 private:
  // Of frames(), beside their pixels' own: 1 at the middle of their residuals' spreads.
  std::vector<float> FrameWeights(const SceneBuffer& buffer) const;
  void EvictBeyondBound(const SceneBuffer& buffer);

  double huber_sigmas_;
  int threads_;
  std::size_t bytes_max_;
  std::size_t bytes_ = 0;
  std::deque<Entry> frames_;
  Roi settled_extent_;
  Image<float> settled_weight_;  // Of frames that are not kept; empty: none.
  Image<float> settled_weighted_;
};

}  // namespace trem
