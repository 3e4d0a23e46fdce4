// Goal: scenes that show the same ground are tied by what they show: across a gap, and between the legs of a flight that drifts; scenes
// of different ground are not.
// Method: scenes rendered from one random texture by the true maps of a simulated sortie (synthetic.h), features and matches of these.
#include "mosaic/align/content_ties.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "mosaic/align/align.h"
#include "mosaic/base/rng.h"
#include "tests/unit/mosaic/align/synthetic.h"
#include "tests/unit/mosaic/align/texture.h"

namespace trem::align {
namespace {

FeatureSource RenderedFeatures(const SyntheticSortie& sortie, const Texture& texture) {
  return [&sortie, &texture](const AlignGraph& graph, int index) -> Result<SceneFeatures> {
    const SceneNode& node = graph.scenes[static_cast<std::size_t>(index)];
    const Roi& roi = node.scene.roi_in_scene;
    const Image<float> intensity = texture.Render(TexelFromWorld(sortie.gsd_m) * sortie.world_from_scene[node.window_id], roi);
    return ExtractFeatures(intensity, Image<float>(roi.width(), roi.height(), 1.0F), roi, graph.input.ratio, {});
  };
}

// Displacements between two maps of scene corners after the best affine map, in gauge pixels, in rising order.
std::vector<double> ShapeErrorsPx(const SyntheticSortie& sortie, const AlignSolution& solution) {
  std::vector<Eigen::Vector2d> truth, estimate;
  for (const AlignedScene& scene : solution.scenes) {
    for (const Eigen::Vector2d& x : RoiCorners(scene.roi_in_scene)) {
      truth.push_back(sortie.world_from_scene[scene.window_id] * x);
      estimate.push_back(scene.world_from_scene * x);
    }
  }
  const Affine fit = *FitAffine(truth, estimate);
  std::vector<double> errors;
  for (std::size_t k = 0; k < truth.size(); ++k) errors.push_back((fit * truth[k] - estimate[k]).norm());
  std::sort(errors.begin(), errors.end());
  return errors;
}

double ShapeErrorPx(const SyntheticSortie& sortie, const AlignSolution& solution) {
  const std::vector<double> errors = ShapeErrorsPx(sortie, solution);
  return errors[errors.size() / 2];
}

TEST(MatchFeatures, FindsTheMapBetweenTwoViewsOfTheSameGround) {
  const Texture texture(5);
  const Roi roi{30, -60, 450, 360};
  Homography first, second;
  first.matrix << 1.0 / 3.0, 0.0, 200.0, 0.0, 1.0 / 3.0, 200.0, 0.0, 0.0, 1.0;
  second.matrix << 0.32, 0.09, 190.0, -0.09, 0.32, 230.0, 0.0, 0.0, 1.0;
  const Image<float> seen(roi.width(), roi.height(), 1.0F);
  const SceneFeatures a = ExtractFeatures(texture.Render(first, roi), seen, roi, 3, {});
  const SceneFeatures b = ExtractFeatures(texture.Render(second, roi), seen, roi, 3, {});
  const auto tie = MatchFeatures(3, a, 8, b, 3, {});
  ASSERT_TRUE(tie.has_value());
  EXPECT_EQ(tie->scene_a, 3);
  EXPECT_EQ(tie->scene_b, 8);
  EXPECT_EQ(tie->x_in_a.size(), 16U);
  std::vector<double> errors_px;  // A texel is a sensor pixel.
  for (std::size_t k = 0; k < tie->x_in_a.size(); ++k) errors_px.push_back((first * tie->x_in_a[k] - second * tie->x_in_b[k]).norm());
  std::sort(errors_px.begin(), errors_px.end());
  EXPECT_LT(errors_px[8], 0.5);
  EXPECT_LT(errors_px.back(), 2.5);
}

TEST(MatchFeatures, TiesNothingBetweenDifferentGrounds) {
  const Roi roi{0, 0, 420, 420};
  const Image<float> seen(roi.width(), roi.height(), 1.0F);
  Homography map;
  map.matrix << 1.0 / 3.0, 0.0, 100.0, 0.0, 1.0 / 3.0, 100.0, 0.0, 0.0, 1.0;
  const SceneFeatures a = ExtractFeatures(Texture(5).Render(map, roi), seen, roi, 3, {});
  const SceneFeatures b = ExtractFeatures(Texture(6).Render(map, roi), seen, roi, 3, {});
  ASSERT_GT(a.x_in_scene.size(), 50U);
  EXPECT_FALSE(MatchFeatures(0, a, 1, b, 3, {}).has_value());
}

TEST(ExtractFeatures, IgnoresCellsThatWereNeverSeen) {
  const Roi roi{0, 0, 420, 420};
  Homography map;
  map.matrix << 1.0 / 3.0, 0.0, 100.0, 0.0, 1.0 / 3.0, 100.0, 0.0, 0.0, 1.0;
  Image<float> intensity = Texture(5).Render(map, roi);
  Image<float> seen(roi.width(), roi.height(), 1.0F);
  for (int y = 0; y < roi.height(); ++y) {
    for (int x = 210; x < roi.width(); ++x) {
      seen.at(x, y) = 0.0F;
      if (y % 2 == 0) intensity.at(x, y) = std::nanf("");
    }
  }
  const SceneFeatures features = ExtractFeatures(intensity, seen, roi, 3, {});
  ASSERT_FALSE(features.x_in_scene.empty());
  for (const Eigen::Vector2d& x : features.x_in_scene) EXPECT_LT(x.x(), 210.0);
}

TEST(Align, JoinsThePiecesOnBothSidesOfAGapByWhatTheyShow) {
  SyntheticOptions options;
  options.telemetry = false;
  options.frame_count = 28;
  options.gap_after_frame = 13;
  options.speed_m = 1.0;  // Both sides see mostly the same ground.
  const SyntheticSortie sortie = MakeSortie(options);
  const Texture texture(5);
  const auto alone = Align(sortie.input, {}, nullptr, nullptr);
  ASSERT_TRUE(alone.ok());
  EXPECT_EQ(alone->piece_count, 2);
  const auto joined = Align(sortie.input, {}, RenderedFeatures(sortie, texture), nullptr);
  ASSERT_TRUE(joined.ok()) << joined.status().ToString();
  EXPECT_EQ(joined->piece_count, 1);
  EXPECT_EQ(joined->join_count, 1);
  EXPECT_LT(ShapeErrorPx(sortie, *joined), 0.5);
}

TEST(Align, ClosesLoopsBetweenLegsThatDrift) {
  SyntheticOptions options;
  options.telemetry = false;
  options.frame_count = 100;
  options.leg_frames = 50;
  options.view_sigma_px = 0.3;  // A poor chain.
  const SyntheticSortie sortie = MakeSortie(options);
  const Texture texture(5);
  const auto open = Align(sortie.input, {}, nullptr, nullptr);
  const auto closed = Align(sortie.input, {}, RenderedFeatures(sortie, texture), nullptr);
  ASSERT_TRUE(open.ok() && closed.ok());
  EXPECT_GT(closed->content_tie_count, 5);
  EXPECT_LT(ShapeErrorPx(sortie, *closed), 0.7 * ShapeErrorPx(sortie, *open));
}

// A survey of photographs: every scene is of one frame, whose perspective is the scene's. Content that bends otherwise, as treetops do that
// each photograph sees displaced, must not bend the scene with it.
TEST(Align, BendsNoSceneOfOneFrameAfterItsContent) {
  SyntheticOptions options;
  options.frame_count = 12;
  SyntheticSortie sortie = MakeSortie(options);
  const std::vector<Segment> windows = std::exchange(sortie.input.segments, {});
  for (const Segment& window : windows) {
    for (std::size_t k = 0; k < window.chain.size(); k += 3) {
      Segment photograph = window;
      photograph.segment_id = static_cast<std::uint32_t>(k);
      photograph.chain = {window.chain[k]};
      for (Scene& scene : photograph.scenes) {
        scene.frame_begin = window.chain[k].frame;
        scene.frame_end = scene.frame_begin + 1;
      }
      sortie.input.segments.push_back(photograph);
    }
  }
  const Texture texture(5);
  const FeatureSource treetops = [&](const AlignGraph& graph, int index) -> Result<SceneFeatures> {
    TREM_ASSIGN_OR_RETURN(SceneFeatures features, RenderedFeatures(sortie, texture)(graph, index));
    const Roi& roi = graph.scenes[static_cast<std::size_t>(index)].scene.roi_in_scene;
    const Eigen::Vector2d half(0.5 * roi.width(), 0.5 * roi.height());
    for (Eigen::Vector2d& x : features.x_in_scene) {
      const Eigen::Vector2d xi = (x - Eigen::Vector2d(roi.x0, roi.y0) - half).cwiseQuotient(half);
      if (index % 5 == 2) x.x() += 6.0 * xi.x() * xi.y();
    }
    return features;
  };
  const auto misled = Align(sortie.input, {}, treetops, nullptr);
  ASSERT_TRUE(misled.ok()) << misled.status().ToString();
  ASSERT_GT(misled->content_tie_count, 0) << "nothing was claimed, so nothing is tested";
  EXPECT_LT(ShapeErrorsPx(sortie, *misled).back(), 0.15);
}

}  // namespace
}  // namespace trem::align
