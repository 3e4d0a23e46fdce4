#include "mosaic/align/align_graph.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <map>
#include <numbers>
#include <set>
#include <tuple>
#include <utility>

#include "mosaic/base/check.h"

namespace trem::align {
namespace {

void SortInput(AlignInput& input) {
  std::sort(input.segments.begin(), input.segments.end(),
            [](const Segment& a, const Segment& b) { return std::tie(a.window_id, a.segment_id) < std::tie(b.window_id, b.segment_id); });
  for (Segment& segment : input.segments) {
    std::sort(segment.chain.begin(), segment.chain.end(), [](const ChainView& a, const ChainView& b) { return a.frame < b.frame; });
    std::sort(segment.scenes.begin(), segment.scenes.end(), [](const Scene& a, const Scene& b) { return a.scene_id < b.scene_id; });
  }
  std::sort(input.anchors.begin(), input.anchors.end(), [](const FrameAnchor& a, const FrameAnchor& b) { return a.frame < b.frame; });
}

// Part of the scene's rectangle that the view's ROI covers, from axis-aligned bounds in the scene plane: views turn little within the
// life of a segment.
double Coverage(const Segment& segment, const ChainView& view, const Scene& scene) {
  Eigen::Vector2d low = Eigen::Vector2d::Constant(1e300);
  Eigen::Vector2d high = Eigen::Vector2d::Constant(-1e300);
  for (const Eigen::Vector2d& u : RoiCorners(segment.roi_in_sensor)) {
    const Eigen::Vector2d x = view.scene_from_sensor * u;
    low = low.cwiseMin(x);
    high = high.cwiseMax(x);
  }
  const double width = std::min(high.x(), scene.roi_in_scene.x1 - 1.0) - std::max(low.x(), static_cast<double>(scene.roi_in_scene.x0));
  const double height = std::min(high.y(), scene.roi_in_scene.y1 - 1.0) - std::max(low.y(), static_cast<double>(scene.roi_in_scene.y0));
  if (width <= 0.0 || height <= 0.0) return 0.0;
  return width * height / std::max(1.0, static_cast<double>(scene.roi_in_scene.area()));
}

struct Candidate {
  int view = 0;
  bool dominates = false;
};

std::vector<Candidate> CandidatesOf(const Segment& segment, const Scene& scene) {
  constexpr double kCoverageMin = 0.5;
  constexpr double kAdjacentCoverageMin = 0.1;
  std::vector<Candidate> candidates;
  // Of a camera that dwells, every view covers every scene: the nearest in time are enough to hold neighbours together.
  constexpr std::int64_t kNeighbourFrames = 12;
  for (std::size_t v = 0; v < segment.chain.size(); ++v) {
    const ChainView& view = segment.chain[v];
    const bool dominates = view.frame >= scene.frame_begin && view.frame < scene.frame_end;
    const bool near = view.frame + kNeighbourFrames >= scene.frame_begin && view.frame < scene.frame_end + kNeighbourFrames;
    // The views just before and after the scene's own hold it to its neighbours in the segment, however small the ROI is beside the scene.
    const bool last_before =
        view.frame < scene.frame_begin && (v + 1 == segment.chain.size() || segment.chain[v + 1].frame >= scene.frame_begin);
    const bool first_after = view.frame >= scene.frame_end && (v == 0 || segment.chain[v - 1].frame < scene.frame_end);
    const double coverage_min = last_before || first_after ? kAdjacentCoverageMin : kCoverageMin;
    if (dominates || (near && Coverage(segment, view, scene) >= coverage_min)) candidates.push_back({static_cast<int>(v), dominates});
  }
  if (!candidates.empty()) return candidates;
  const double middle = 0.5 * (static_cast<double>(scene.frame_begin) + scene.frame_end);
  int nearest = 0;
  for (std::size_t v = 1; v < segment.chain.size(); ++v) {
    if (std::abs(segment.chain[v].frame - middle) < std::abs(segment.chain[static_cast<std::size_t>(nearest)].frame - middle))
      nearest = static_cast<int>(v);
  }
  return {{nearest, false}};
}

// The frames to use: every stride-th of all that appear (`seen`), as many more as scenes need, spread over the scene's candidates, and
// those that show a control point.
std::set<std::uint32_t> ChooseFrames(const AlignGraph& graph, const std::vector<std::vector<Candidate>>& candidates,
                                     const std::set<std::uint32_t>& seen, const AlignOptions& options) {
  std::set<std::uint32_t> used;
  for (std::size_t s = 0; s < graph.scenes.size(); ++s) {
    const Segment& segment = graph.input.segments[static_cast<std::size_t>(graph.scenes[s].segment)];
    std::vector<std::uint32_t> own;
    std::size_t chosen = 0;
    for (const Candidate& candidate : candidates[s]) {
      const std::uint32_t frame = segment.chain[static_cast<std::size_t>(candidate.view)].frame;
      if (candidate.dominates || candidates[s].size() == 1) own.push_back(frame);
      if (frame % static_cast<std::uint32_t>(graph.stride) == 0) {
        used.insert(frame);
        ++chosen;
      }
    }
    const auto wanted = static_cast<std::size_t>(options.frames_per_scene_min);
    if (chosen >= wanted || own.empty()) continue;
    const std::size_t extra = std::min(wanted, own.size());
    for (std::size_t k = 0; k < extra; ++k) used.insert(own[(2 * k + 1) * own.size() / (2 * extra)]);
  }
  for (const ControlObservation& control : graph.input.control) {
    if (seen.count(control.frame) > 0) used.insert(control.frame);
  }
  return used;
}

}  // namespace

std::array<Eigen::Vector2d, 4> RoiCorners(const Roi& roi) {
  const double x0 = roi.x0, y0 = roi.y0, x1 = roi.x1 - 1.0, y1 = roi.y1 - 1.0;
  return {Eigen::Vector2d(x0, y0), Eigen::Vector2d(x1, y0), Eigen::Vector2d(x1, y1), Eigen::Vector2d(x0, y1)};
}

std::array<Eigen::Vector2d, 4> TiePoints(const Roi& roi) {
  std::array<Eigen::Vector2d, 4> points = RoiCorners(roi);
  const Eigen::Vector2d centre = 0.5 * (points[0] + points[2]);
  for (Eigen::Vector2d& point : points) point = centre + (point - centre) / std::numbers::sqrt3;
  return points;
}

AlignGraph BuildAlignGraph(AlignInput input, const AlignOptions& options) {
  SortInput(input);
  AlignGraph graph;
  graph.input = std::move(input);
  std::vector<std::vector<Candidate>> candidates;
  std::set<std::uint32_t> seen;
  for (std::size_t g = 0; g < graph.input.segments.size(); ++g) {
    const Segment& segment = graph.input.segments[g];
    if (segment.scenes.empty()) continue;
    TREM_CHECK(!segment.chain.empty());
    for (const Scene& scene : segment.scenes) {
      graph.scenes.push_back({segment.window_id, static_cast<int>(g), scene, {}});
      candidates.push_back(CandidatesOf(segment, scene));
      for (const Candidate& candidate : candidates.back()) seen.insert(segment.chain[static_cast<std::size_t>(candidate.view)].frame);
    }
  }
  const auto frame_count = static_cast<int>(seen.size());
  graph.stride = std::clamp((frame_count + options.frames_max - 1) / std::max(1, options.frames_max), 1, options.stride_max);

  std::map<std::uint32_t, int> index_of_frame;
  for (const std::uint32_t frame : ChooseFrames(graph, candidates, seen, options)) {
    index_of_frame[frame] = static_cast<int>(graph.frames.size());
    const auto anchor = std::lower_bound(graph.input.anchors.begin(), graph.input.anchors.end(), frame,
                                         [](const FrameAnchor& a, std::uint32_t f) { return a.frame < f; });
    const bool found = anchor != graph.input.anchors.end() && anchor->frame == frame;
    graph.frames.push_back({frame, found ? static_cast<int>(anchor - graph.input.anchors.begin()) : -1, {}});
  }
  for (std::size_t s = 0; s < graph.scenes.size(); ++s) {
    const Segment& segment = graph.input.segments[static_cast<std::size_t>(graph.scenes[s].segment)];
    for (const Candidate& candidate : candidates[s]) {
      const auto found = index_of_frame.find(segment.chain[static_cast<std::size_t>(candidate.view)].frame);
      if (found == index_of_frame.end()) continue;
      const int tie = static_cast<int>(graph.ties.size());
      graph.ties.push_back(
          {found->second, static_cast<int>(s), candidate.view, candidate.dominates ? options.tie_floor_px : options.neighbour_floor_px});
      graph.scenes[s].ties.push_back(tie);
      graph.frames[static_cast<std::size_t>(found->second)].ties.push_back(tie);
    }
  }
  return graph;
}

}  // namespace trem::align
