// Goal: scenes that share no frames get the brightness that their common ground asks for, and what the lens darkens is found and undone.
// Method: scenes rendered from one texture by the true maps of a simulated sortie (synthetic.h), with an exposure step in a gap that no
// window straddles, and darker towards the image's corners; what the balance makes of them against the ground.
#include "mosaic/align/level_ties.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "mosaic/align/align.h"
#include "tests/unit/mosaic/align/synthetic.h"
#include "tests/unit/mosaic/align/texture.h"

namespace trem::align {
namespace {

constexpr double kStepGain = 1.3;
constexpr double kStepOffset = -12.0;
constexpr int kGapAfter = 13;

SyntheticOptions WithAGap() {
  SyntheticOptions options;
  options.frame_count = 28;
  options.gap_after_frame = kGapAfter;
  options.speed_m = 1.0;
  return options;
}

// What the lens leaves at cell `c` of a scene, as its middle frame sees it.
double LensFactor(const AlignGraph& graph, const SceneNode& node, double corner_loss, const Eigen::Vector2d& c) {
  const Segment& segment = graph.input.segments[static_cast<std::size_t>(node.segment)];
  const std::uint32_t middle = (node.scene.frame_begin + node.scene.frame_end) / 2;
  const auto view = std::find_if(segment.chain.begin(), segment.chain.end(), [&](const ChainView& v) { return v.frame == middle; });
  const Eigen::Vector2d centre(0.5 * (graph.input.width_px - 1), 0.5 * (graph.input.height_px - 1));
  const Eigen::Vector2d u = view->scene_from_sensor.Inverse() * c;
  return 1.0 - corner_loss * (u - centre).squaredNorm() / centre.squaredNorm();
}

bool AfterTheStep(const SceneNode& node) { return node.scene.frame_begin > static_cast<std::uint32_t>(kGapAfter); }

FeatureSource Rendered(const SyntheticSortie& sortie, const Texture& texture, double corner_loss) {
  return [&sortie, &texture, corner_loss](const AlignGraph& graph, int index) -> Result<SceneFeatures> {
    const SceneNode& node = graph.scenes[static_cast<std::size_t>(index)];
    const Roi& roi = node.scene.roi_in_scene;
    Image<float> intensity = texture.Render(TexelFromWorld(sortie.gsd_m) * sortie.world_from_scene[node.window_id], roi);
    for (int y = 0; y < roi.height(); ++y) {
      for (int x = 0; x < roi.width(); ++x) {
        const double lens = LensFactor(graph, node, corner_loss, Eigen::Vector2d(roi.x0 + x, roi.y0 + y));
        const double level = AfterTheStep(node) ? kStepGain * intensity.at(x, y) + kStepOffset : intensity.at(x, y);
        intensity.at(x, y) = static_cast<float>(lens * level);
      }
    }
    const Image<float> information(roi.width(), roi.height(), 1.0F);
    SceneFeatures features = ExtractFeatures(intensity, information, roi, graph.input.ratio, {});
    features.levels = MeanLevels(intensity, information, roi, graph.input.ratio);
    return features;
  };
}

// How far apart the scenes show ground of grey levels 100 and 160 after balancing, away from the lens' influence.
double SpreadOfLevels(const SyntheticSortie& sortie, const AlignSolution& solution) {
  double spread = 0.0;
  for (const double ground : {100.0, 160.0}) {
    std::vector<double> levels;
    for (const AlignedScene& scene : solution.scenes) {
      const bool after = sortie.first_frame[scene.window_id] > kGapAfter;
      const double level = after ? kStepGain * ground + kStepOffset : ground;
      levels.push_back(scene.balanced_from_scene.gain * level + scene.balanced_from_scene.offset);
    }
    const auto [low, high] = std::minmax_element(levels.begin(), levels.end());
    spread = std::max(spread, *high - *low);
  }
  return spread;
}

TEST(LevelTies, BalanceScenesThatShareNoFrames) {
  const SyntheticSortie sortie = MakeSortie(WithAGap());
  const Texture texture(5);
  const auto balanced = Align(sortie.input, {}, Rendered(sortie, texture, 0.0), nullptr);
  ASSERT_TRUE(balanced.ok()) << balanced.status().ToString();
  EXPECT_GT(balanced->level_tie_count, 10);
  EXPECT_LT(SpreadOfLevels(sortie, *balanced), 1.55) << "grey levels, of an exposure step of 18 and more";
  EXPECT_LT(std::abs(balanced->vignetting.At({1.0, 1.0}) - 1.0), 0.02) << "nothing is found where nothing is";
  const auto alone = Align(sortie.input, {}, nullptr, nullptr);
  ASSERT_TRUE(alone.ok());
  EXPECT_GT(SpreadOfLevels(sortie, *alone), 15.0) << "negative control: nothing ties the brightness across the gap";
}

TEST(LevelTies, FindWhatTheLensDarkens) {
  constexpr double kCornerLoss = 0.3;
  const SyntheticSortie sortie = MakeSortie(WithAGap());
  const Texture texture(5);
  const auto balanced = Align(sortie.input, {}, Rendered(sortie, texture, kCornerLoss), nullptr);
  ASSERT_TRUE(balanced.ok()) << balanced.status().ToString();
  for (const double r2 : {0.25, 0.5, 0.9}) EXPECT_NEAR(balanced->vignetting.At({r2, r2 * r2}), 1.0 - kCornerLoss * r2, 0.025) << r2;
  EXPECT_LT(SpreadOfLevels(sortie, *balanced), 3.0);
  for (const AlignedScene& scene : balanced->scenes) ASSERT_FALSE(scene.shade.empty());
}

}  // namespace
}  // namespace trem::align
