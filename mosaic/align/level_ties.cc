#include "mosaic/align/level_ties.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "mosaic/align/content_ties.h"
#include "mosaic/base/parallel.h"

namespace trem::align {
namespace {

constexpr int kBlockPx = 3;      // Sensor pixels.
constexpr int kPatchBlocks = 3;  // Blocks along a patch.
constexpr int kPairsMax = 48;    // Patches kept a tie.
constexpr int kPairsMin = 4;

// Mean over the patch of blocks around `shown`, bilinear between blocks; NaN where one of them was not seen.
double PatchLevel(const SceneLevels& levels, const std::vector<Eigen::Vector2d>& shown) {
  double sum = 0.0;
  for (const Eigen::Vector2d& c : shown) {
    const Eigen::Vector2d node = (c - levels.first) / levels.step;
    if (!(node.x() >= 0.0 && node.y() >= 0.0 && node.x() <= levels.columns - 1.0 && node.y() <= levels.rows - 1.0))
      return std::numeric_limits<double>::quiet_NaN();
    sum += levels.At(c);
  }
  return sum / static_cast<double>(shown.size());
}

// The places of a patch's blocks as both scenes show them.
std::optional<LevelPair> PairAt(const AlignGraph& graph, const AlignState& state, std::span<const SceneLevels> levels, int a, int b,
                                int column, int row) {
  const auto ia = static_cast<std::size_t>(a), ib = static_cast<std::size_t>(b);
  const SceneState& scene_a = state.scenes[ia];
  const SceneState& scene_b = state.scenes[ib];
  const Homography b_from_world = scene_b.world_from_scene.Inverse();
  std::vector<Eigen::Vector2d> in_a, in_b;
  for (int j = 0; j < kPatchBlocks; ++j) {
    for (int i = 0; i < kPatchBlocks; ++i) {
      in_a.push_back(levels[ia].Node(column + i, row + j));
      in_b.push_back(Shifted(scene_b.shifts, b_from_world * WorldFromShown(scene_a, in_a.back())));
    }
  }
  LevelPair pair;
  pair.level_a = PatchLevel(levels[ia], in_a);
  pair.level_b = PatchLevel(levels[ib], in_b);
  if (!std::isfinite(pair.level_a) || !std::isfinite(pair.level_b)) return std::nullopt;
  const std::size_t middle = in_a.size() / 2;
  pair.field_a = FieldPowersAt(graph, a, in_a[middle]);
  pair.field_b = FieldPowersAt(graph, b, in_b[middle]);
  return pair;
}

}  // namespace

SceneLevels MeanLevels(const Image<float>& intensity, const Image<float>& information, const Roi& roi_in_scene, int ratio) {
  SceneLevels levels;
  const int side = kBlockPx * ratio;
  levels.columns = intensity.width() / side;
  levels.rows = intensity.height() / side;
  if (levels.columns < 2 || levels.rows < 2) return {};
  levels.step = side;
  levels.first = Eigen::Vector2d(roi_in_scene.x0, roi_in_scene.y0) + Eigen::Vector2d::Constant(0.5 * (side - 1));
  for (int row = 0; row < levels.rows; ++row) {
    for (int column = 0; column < levels.columns; ++column) {
      double sum = 0.0;
      for (int y = row * side; y < (row + 1) * side; ++y) {
        for (int x = column * side; x < (column + 1) * side; ++x) {
          sum += information.at(x, y) > 0.0F ? static_cast<double>(intensity.at(x, y)) : std::numeric_limits<double>::quiet_NaN();
        }
      }
      levels.values.push_back(sum / (side * side));
    }
  }
  return levels;
}

FieldPowers FieldPowersAt(const AlignGraph& graph, int scene, const Eigen::Vector2d& shown) {
  const SceneNode& node = graph.scenes[static_cast<std::size_t>(scene)];
  const Eigen::Vector2d centre(0.5 * (graph.input.width_px - 1), 0.5 * (graph.input.height_px - 1));
  FieldPowers powers;
  double weight = 0.0;
  for (const int t : node.ties) {
    const Tie& tie = graph.ties[static_cast<std::size_t>(t)];
    const Roi& roi = graph.SegmentOf(tie).roi_in_sensor;
    const Eigen::Vector2d u = graph.ViewOf(tie).scene_from_sensor.Inverse() * shown;
    // Frames that did not see the place tell only where none did.
    const bool inside = u.x() >= roi.x0 && u.y() >= roi.y0 && u.x() < roi.x1 && u.y() < roi.y1;
    const double w = inside ? 1.0 : 1e-4;
    const Eigen::Vector2d clamped = u.cwiseMax(Eigen::Vector2d(roi.x0, roi.y0)).cwiseMin(Eigen::Vector2d(roi.x1 - 1.0, roi.y1 - 1.0));
    const double r2 = (clamped - centre).squaredNorm() / centre.squaredNorm();
    powers.second += w * r2;
    powers.fourth += w * r2 * r2;
    weight += w;
  }
  if (weight > 0.0) powers = {powers.second / weight, powers.fourth / weight};
  return powers;
}

std::vector<LevelTie> FindLevelTies(const AlignGraph& graph, const AlignState& state, std::span<const SceneLevels> levels, int threads) {
  ContentOptions options;
  options.overlap_min = 0.1;
  options.partners_max = 9;
  options.cross_piece_pairs_max = 0;
  options.may_share_frames = true;
  std::vector<bool> takes_part(graph.scenes.size());
  for (std::size_t s = 0; s < levels.size(); ++s) takes_part[s] = !levels[s].empty();
  const std::vector<std::pair<int, int>> candidates = CandidatePairs(graph, state, takes_part, options);
  std::vector<LevelTie> ties(candidates.size());
  ForEachIndex(threads, static_cast<int>(candidates.size()), [&](int index, int) {
    const auto [a, b] = candidates[static_cast<std::size_t>(index)];
    LevelTie& tie = ties[static_cast<std::size_t>(index)];
    tie = {a, b, {}};
    const SceneLevels& blocks = levels[static_cast<std::size_t>(a)];
    std::vector<LevelPair> pairs;
    for (int row = 0; row + kPatchBlocks <= blocks.rows; row += kPatchBlocks) {
      for (int column = 0; column + kPatchBlocks <= blocks.columns; column += kPatchBlocks) {
        if (const std::optional<LevelPair> pair = PairAt(graph, state, levels, a, b, column, row)) pairs.push_back(*pair);
      }
    }
    const std::size_t count = std::min<std::size_t>(pairs.size(), kPairsMax);
    if (count < static_cast<std::size_t>(kPairsMin)) return;
    for (std::size_t k = 0; k < count; ++k) tie.pairs.push_back(pairs[(2 * k + 1) * pairs.size() / (2 * count)]);
  });
  std::erase_if(ties, [](const LevelTie& tie) { return tie.pairs.empty(); });
  return ties;
}

}  // namespace trem::align
