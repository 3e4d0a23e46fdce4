#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "mosaic/align/frames_and_scenes.h"

namespace trem::align {

struct SceneNode {
  std::uint32_t window_id = 0;
  int segment = 0;  // Index into AlignGraph::input.segments.
  Scene scene;
  std::vector<int> ties;  // Indices into AlignGraph::ties.
};

struct FrameNode {
  std::uint32_t frame = 0;
  int anchor = -1;  // Index into AlignGraph::input.anchors; -1: none.
  std::vector<int> ties;
};

// Frame `frame` saw scene `scene`: view `view` of the scene's segment.
struct Tie {
  int frame = 0;  // Index into AlignGraph::frames.
  int scene = 0;  // Index into AlignGraph::scenes.
  int view = 0;   // Index into the segment's chain.
  double floor_px = 0.0;
};

// The bipartite graph of used frames and emitted scenes. Sorted: frames by index, scenes by (window, segment, scene), ties by
// (scene, frame), whatever the order of the input.
struct AlignGraph {
  AlignInput input;  // Segments sorted by (window, segment), chains by frame, anchors by frame.
  std::vector<FrameNode> frames;
  std::vector<SceneNode> scenes;
  std::vector<Tie> ties;
  int stride = 1;

  const Segment& SegmentOf(const Tie& tie) const {
    return input.segments[static_cast<std::size_t>(scenes[static_cast<std::size_t>(tie.scene)].segment)];
  }
  const ChainView& ViewOf(const Tie& tie) const { return SegmentOf(tie).chain[static_cast<std::size_t>(tie.view)]; }
};

// Sorts the input, chooses the frames to use (AlignOptions::frames_max) and lists the ties: a scene is tied to the frames that dominate
// it and to their neighbours in the chain whose ROI still covers at least half of it. Scenes without any view in their range are tied to
// the nearest view of the chain. Precondition: every segment with scenes has at least one chain view.
AlignGraph BuildAlignGraph(AlignInput input, const AlignOptions& options);

// Points of a ROI at which a view's map is taken: on its diagonals at 1/sqrt(3) of the way from the centre to the corners, where the mean of
// any quadratic displacement is its mean over the ROI. An affine view is the best fit over the ROI, so that is where it is right. Order
// as RoiCorners.
std::array<Eigen::Vector2d, 4> TiePoints(const Roi& roi_in_sensor);

// Sensor pixels at the corners of a ROI's outermost pixels: upper left, upper right, lower right, lower left.
std::array<Eigen::Vector2d, 4> RoiCorners(const Roi& roi_in_sensor);

}  // namespace trem::align
