// Goal: the alignment recovers where scenes lie, says honestly how well, and survives bad ties, gaps and missing telemetry.
// Method: chains simulated from true cameras over flat ground (synthetic.h) with known noise; recovered maps against the truth.
#include "mosaic/align/align.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <iostream>
#include <numeric>

#include "mosaic/base/rng.h"
#include "tests/unit/mosaic/align/synthetic.h"

namespace trem::align {
namespace {

using ::testing::HasSubstr;

AlignSolution MustAlign(const AlignInput& input, const AlignOptions& options = {}) {
  Result<AlignSolution> solution = Align(input, options, nullptr, nullptr);
  EXPECT_TRUE(solution.ok()) << solution.status().ToString();
  return solution.ok() ? *solution : AlignSolution{};
}

// Displacements of scene corners, in sensor pixels: estimate minus truth, the truth mapped by `estimate_from_truth`.
std::vector<Eigen::Vector2d> ErrorsPx(const SyntheticSortie& sortie, const AlignSolution& solution, const Homography& estimate_from_truth,
                                      double gsd) {
  std::vector<Eigen::Vector2d> errors;
  for (const AlignedScene& scene : solution.scenes) {
    const Homography truth = estimate_from_truth * sortie.world_from_scene[scene.window_id];
    for (const Eigen::Vector2d& x : RoiCorners(scene.roi_in_scene)) errors.push_back((scene.world_from_scene * x - truth * x) / gsd);
  }
  return errors;
}

Eigen::Vector2d Mean(const std::vector<Eigen::Vector2d>& errors) {
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& e : errors) mean += e / static_cast<double>(errors.size());
  return mean;
}

double P95AroundMean(const std::vector<Eigen::Vector2d>& errors) {
  const Eigen::Vector2d mean = Mean(errors);
  std::vector<double> norms;
  for (const Eigen::Vector2d& e : errors) norms.push_back((e - mean).norm());
  std::sort(norms.begin(), norms.end());
  return norms[norms.size() * 95 / 100];
}

// Over a wide oblique view an affine map is a fit only; ties are taken where it is right, and its twist, of which it knows nothing, is left out.
// So views of either kind tie the frames as well as their noise allows.
TEST(Align, ViewsOfEitherModelTieFramesOfAWideObliqueCamera) {
  for (const bool projective : {false, true}) {
    SyntheticOptions options;
    options.pitch_deg = -45.0;
    options.hfov_deg = 25.0;
    options.view_sigma_px = 0.005;
    options.projective_views = projective;
    const SyntheticSortie sortie = MakeSortie(options);
    const AlignSolution solution = MustAlign(sortie.input);
    EXPECT_LT(solution.tie_rms_px, 0.006);
    EXPECT_TRUE(solution.outlier_ties.empty());
    EXPECT_LT(P95AroundMean(ErrorsPx(sortie, solution, {}, sortie.gsd_m)), 0.15);
  }
}

TEST(Align, RecoversNadirScenesFromExactTelemetry) {
  const SyntheticSortie sortie = MakeSortie({});
  const AlignSolution solution = MustAlign(sortie.input);
  const auto errors = ErrorsPx(sortie, solution, {}, sortie.gsd_m);
  ASSERT_GT(errors.size(), 40U);
  EXPECT_LT(P95AroundMean(errors), 0.1);
  EXPECT_LT(Mean(errors).norm(), 0.3);
  EXPECT_TRUE(solution.georeferenced);
  EXPECT_EQ(solution.piece_count, 1);
  EXPECT_TRUE(solution.outlier_ties.empty());
  EXPECT_EQ(solution.frames.size(), 40U);
}

class NoisyTelemetry : public ::testing::TestWithParam<double> {};

TEST_P(NoisyTelemetry, LeavesRelativeGeometryToThePixelsAndAbsolutePlaceToTheBias) {
  SyntheticOptions options;
  options.pitch_deg = GetParam();
  options.position_bias_m = 1.0;
  options.position_white_m = 0.2;
  options.attitude_white_deg = 0.05;
  const SyntheticSortie sortie = MakeSortie(options);
  const auto errors = ErrorsPx(sortie, MustAlign(sortie.input), {}, sortie.gsd_m);
  EXPECT_LT(P95AroundMean(errors), 0.5) << "the error that varies over the mosaic, px";
  // The shared error has a sigma of 1 m in each coordinate; 4 sigma, plus what 0.05 degrees white leave of 566 m of range.
  EXPECT_LT(Mean(errors).norm() * sortie.gsd_m, 4.0 * 1.5);
  // Negative control: telemetry alone misplaces frames by more than a pixel against each other.
  std::vector<Eigen::Vector2d> raw;
  for (const FrameAnchor& anchor : sortie.input.anchors) {
    const Homography told = GroundFromSensor(*anchor.pose, {sortie.input.width_px, sortie.input.height_px, anchor.focal_px}, 0.0);
    const Eigen::Vector2d u(127.5, 99.5);
    raw.push_back((told * u - sortie.world_from_sensor[anchor.frame] * u) / sortie.gsd_m);
  }
  EXPECT_GT(P95AroundMean(raw), 1.0);
}

INSTANTIATE_TEST_SUITE_P(NadirAndOblique, NoisyTelemetry, ::testing::Values(-90.0, -45.0));

TEST(Align, WithoutTelemetryUsesTheMiddleFrameAsItsGauge) {
  SyntheticOptions options;
  options.telemetry = false;
  const SyntheticSortie sortie = MakeSortie(options);
  const AlignSolution solution = MustAlign(sortie.input);
  EXPECT_FALSE(solution.georeferenced);
  EXPECT_EQ(solution.piece_count, 1);
  EXPECT_THAT(solution.gauge, HasSubstr("frame 20"));
  Homography upright;
  upright.matrix << 1.0, 0.0, -127.5, 0.0, -1.0, 99.5, 0.0, 0.0, 1.0;
  const Homography estimate_from_truth = upright * sortie.world_from_sensor[20].Inverse();
  const auto errors = ErrorsPx(sortie, solution, estimate_from_truth, 1.0);
  EXPECT_LT(P95AroundMean(errors), 1.0);
  for (const AlignedFrame& frame : solution.frames) {
    if (frame.frame != 20) continue;
    EXPECT_LT((frame.world_from_sensor * Eigen::Vector2d(0.0, 0.0) - Eigen::Vector2d(-127.5, 99.5)).norm(), 1e-6);
  }
}

TEST(Align, TiesLegsOfALawnmowerThroughTelemetry) {
  SyntheticOptions options;
  options.frame_count = 60;
  options.leg_frames = 20;
  options.position_bias_m = 0.5;
  options.attitude_white_deg = 0.02;
  const SyntheticSortie sortie = MakeSortie(options);
  EXPECT_LT(P95AroundMean(ErrorsPx(sortie, MustAlign(sortie.input), {}, sortie.gsd_m)), 0.5);
}

TEST(Align, DownWeightsAndNamesAnOutlierTie) {
  SyntheticOptions options;
  options.attitude_white_deg = 0.01;
  SyntheticSortie sortie = MakeSortie(options);
  const auto clean = ErrorsPx(sortie, MustAlign(sortie.input), {}, sortie.gsd_m);
  ChainView& bad = sortie.input.segments[0].chain[10];
  bad.scene_from_sensor.offset += 3.0 * Eigen::Vector2d(9.0, -5.0);  // 10 sensor px.
  const AlignSolution solution = MustAlign(sortie.input);
  ASSERT_FALSE(solution.outlier_ties.empty());
  for (const OutlierTie& tie : solution.outlier_ties) {
    EXPECT_EQ(tie.window_id, 0U);
    EXPECT_EQ(tie.frame, 10U);
    EXPECT_GT(tie.error_px, 5.0);
  }
  const auto dirty = ErrorsPx(sortie, solution, {}, sortie.gsd_m);
  ASSERT_EQ(dirty.size(), clean.size());
  for (std::size_t k = 0; k < dirty.size(); ++k) EXPECT_LT((dirty[k] - clean[k]).norm(), 0.1) << k;
}

TEST(Align, HoldsTheScenesOfASegmentTogetherWhenTheRoiIsSmallBesideThem) {
  // With their margins the scenes are more than twice as large as the ROI: no view covers half of one.
  AlignInput input;
  input.width_px = 128;
  input.height_px = 100;
  input.ratio = 2;
  Segment segment;
  segment.roi_in_sensor = {0, 0, 61, 61};
  for (std::uint32_t frame = 0; frame < 18; ++frame) {
    ChainView view;
    view.frame = frame;
    view.scene_from_sensor = {2.0 * Eigen::Matrix2d::Identity(), Eigen::Vector2d(8.0 * frame, 0.0)};
    view.corner_covariance_px2 = Matrix6d::Identity() * 1e-4;
    view.gain_offset_covariance = Eigen::Matrix2d::Identity() * 1e-4;
    segment.chain.push_back(view);
  }
  for (int scene = 0; scene < 3; ++scene) {
    const int left = 8 * 6 * scene;
    segment.scenes.push_back({static_cast<std::uint32_t>(scene), Roi{left - 24, -24, left + 8 * 5 + 122 + 24, 122 + 24},
                              static_cast<std::uint32_t>(6 * scene), static_cast<std::uint32_t>(6 * scene + 6)});
  }
  input.segments.push_back(segment);
  const AlignSolution solution = MustAlign(input);
  EXPECT_EQ(solution.piece_count, 1);
  ASSERT_EQ(solution.scenes.size(), 3u);
  // One plane: all scenes have the same map.
  const Eigen::Vector2d cell(200.0, 60.0);
  for (const AlignedScene& scene : solution.scenes) {
    EXPECT_LT((scene.world_from_scene * cell - solution.scenes[0].world_from_scene * cell).norm(), 0.01) << scene.scene_id;
  }
}

TEST(Align, KeepsPiecesApartWithoutTelemetryAndPlacesThemWithIt) {
  SyntheticOptions options;
  options.gap_after_frame = 19;
  options.telemetry = false;
  const AlignSolution local = MustAlign(MakeSortie(options).input);
  EXPECT_EQ(local.piece_count, 2);
  EXPECT_THAT(local.gauge, HasSubstr("arbitrary"));
  double right_of_first = -1e300, left_of_second = 1e300;
  for (const AlignedScene& scene : local.scenes) {
    for (const Eigen::Vector2d& x : RoiCorners(scene.roi_in_scene)) {
      const double at = (scene.world_from_scene * x).x();
      if (scene.piece == 0) right_of_first = std::max(right_of_first, at);
      if (scene.piece == 1) left_of_second = std::min(left_of_second, at);
    }
  }
  EXPECT_GT(left_of_second, right_of_first);

  options.telemetry = true;
  options.attitude_white_deg = 0.01;
  const SyntheticSortie sortie = MakeSortie(options);
  const AlignSolution placed = MustAlign(sortie.input);
  EXPECT_EQ(placed.piece_count, 2);
  EXPECT_LT(P95AroundMean(ErrorsPx(sortie, placed, {}, sortie.gsd_m)), 1.0);
}

TEST(Align, PlacesFramesWithoutTelemetryThroughTheirNeighbours) {
  SyntheticSortie sortie = MakeSortie({});
  std::erase_if(sortie.input.anchors, [](const FrameAnchor& anchor) { return anchor.frame % 3 != 0; });
  const AlignSolution solution = MustAlign(sortie.input);
  EXPECT_EQ(solution.frames.size(), 40U);
  EXPECT_LT(P95AroundMean(ErrorsPx(sortie, solution, {}, sortie.gsd_m)), 0.2);
}

TEST(Align, LeavesOutAPieceThatNothingConnectsToTelemetry) {
  SyntheticOptions options;
  options.gap_after_frame = 19;
  SyntheticSortie sortie = MakeSortie(options);
  std::erase_if(sortie.input.anchors, [](const FrameAnchor& anchor) { return anchor.frame >= 20; });
  const AlignSolution solution = MustAlign(sortie.input);
  EXPECT_TRUE(solution.georeferenced);
  EXPECT_EQ(solution.piece_count, 1);
  EXPECT_FALSE(solution.unplaced_scenes.empty());
  for (const AlignedFrame& frame : solution.frames) EXPECT_LT(frame.frame, 20U);
}

TEST(Align, UsesGroundCornersInsteadOfPoses) {
  SyntheticSortie sortie = MakeSortie({});
  for (FrameAnchor& anchor : sortie.input.anchors) {
    const Homography& map = sortie.world_from_sensor[anchor.frame];
    anchor.corners = {map * Eigen::Vector2d(-0.5, -0.5), map * Eigen::Vector2d(255.5, -0.5), map * Eigen::Vector2d(255.5, 199.5),
                      map * Eigen::Vector2d(-0.5, 199.5)};
    anchor.pose.reset();
  }
  const auto errors = ErrorsPx(sortie, MustAlign(sortie.input), {}, sortie.gsd_m);
  EXPECT_LT(P95AroundMean(errors), 0.1);
  EXPECT_LT(Mean(errors).norm(), 0.1);
}

TEST(Align, SkipsRoisThatReachTheHorizonAndSaysWhichFrames) {
  SyntheticSortie sortie = MakeSortie({});
  for (FrameAnchor& anchor : sortie.input.anchors) {
    if (anchor.frame == 7) anchor.pose->pitch_rad = 0.0;  // Telemetry that looks level: the upper ROIs would be sky.
  }
  const AlignSolution solution = MustAlign(sortie.input);
  EXPECT_THAT(solution.horizon_frames, ::testing::ElementsAre(7U));
  EXPECT_EQ(solution.piece_count, 1);
}

TEST(Align, ThinsALongSortieToOneStrideAndStillPlacesEveryFrame) {
  SyntheticOptions options;
  options.frame_count = 60;
  const SyntheticSortie sortie = MakeSortie(options);
  AlignOptions thin;
  thin.frames_max = 20;
  const AlignSolution solution = MustAlign(sortie.input, thin);
  EXPECT_LT(solution.used_frame_count, 60);
  EXPECT_EQ(solution.frames.size(), 60U);
  EXPECT_LT(P95AroundMean(ErrorsPx(sortie, solution, {}, sortie.gsd_m)), 0.3);
}

TEST(Align, GivesTheSameBitsOnEveryRunAndForAnyOrderOfWindows) {
  SyntheticOptions options;
  options.position_bias_m = 1.0;
  options.attitude_white_deg = 0.05;
  const SyntheticSortie sortie = MakeSortie(options);
  AlignInput shuffled = sortie.input;
  Rng rng({99});
  for (std::size_t i = shuffled.segments.size(); i > 1; --i)
    std::swap(shuffled.segments[i - 1], shuffled.segments[rng.UniformIndex(static_cast<std::uint32_t>(i))]);
  std::reverse(shuffled.anchors.begin(), shuffled.anchors.end());
  const AlignSolution first = MustAlign(sortie.input);
  for (const AlignInput& input : {sortie.input, shuffled}) {
    const AlignSolution again = MustAlign(input);
    ASSERT_EQ(again.scenes.size(), first.scenes.size());
    for (std::size_t s = 0; s < first.scenes.size(); ++s) {
      EXPECT_EQ(again.scenes[s].world_from_scene.matrix, first.scenes[s].world_from_scene.matrix);
      EXPECT_EQ(again.scenes[s].position_sigma, first.scenes[s].position_sigma);
      EXPECT_EQ(again.scenes[s].balanced_from_scene.gain, first.scenes[s].balanced_from_scene.gain);
    }
    for (std::size_t f = 0; f < first.frames.size(); ++f)
      EXPECT_EQ(again.frames[f].world_from_sensor.matrix, first.frames[f].world_from_sensor.matrix);
  }
}

struct SigmaCase {
  std::string name;
  double pitch_deg;
  double hfov_deg;
  int leg_frames;
  Boresight boresight;
  bool control = false;
};

class StatedSigma : public ::testing::TestWithParam<SigmaCase> {};

// Receiver and boresight err once a sortie, so that only many sorties tell whether a stated standard error holds: 80 seeds, one scene each.
// The sigma is that of the worse axis, which is the look direction (north) of an oblique camera. Over seeds the error along it is normal:
// Binomial(80, .683): P(< 41 or > 67) = 1e-3 within one sigma; Binomial(80, .954): P(< 70) = 1e-3 within two.
TEST_P(StatedSigma, CoversTheTrueErrorAtItsNominalRate) {
  constexpr int kSorties = 80;
  int within_one = 0, within_two = 0;
  double squares = 0.0, stated = 0.0;
  for (std::uint64_t seed = 1; seed <= kSorties; ++seed) {
    SyntheticOptions options;
    options.seed = seed;
    options.pitch_deg = GetParam().pitch_deg;
    options.hfov_deg = GetParam().hfov_deg;
    options.leg_frames = GetParam().leg_frames;
    options.frame_count = GetParam().leg_frames > 0 ? 2 * GetParam().leg_frames : 14;
    options.position_bias_m = 1.0;
    options.position_white_m = 0.2;
    options.attitude_bias_deg = 0.05;
    options.attitude_white_deg = 0.05;
    SyntheticSortie sortie = MakeSortie(options);
    sortie.input.boresight = GetParam().boresight;
    if (GetParam().control) {
      sortie.input.control = FourPoints(options, sortie);
      sortie.input.control_sigma_px = 0.2;
      sortie.input.control_sigma_m = 1e-3;
    }
    const AlignSolution solution = MustAlign(sortie.input);
    const AlignedScene& scene = solution.scenes.front();
    const Roi& roi = scene.roi_in_scene;
    const Eigen::Vector2d centre(0.5 * (roi.x0 + roi.x1 - 1), 0.5 * (roi.y0 + roi.y1 - 1));
    const double error_m = (scene.world_from_scene * centre - sortie.world_from_scene[scene.window_id] * centre).y();
    within_one += std::abs(error_m) <= scene.position_sigma ? 1 : 0;
    within_two += std::abs(error_m) <= 2.0 * scene.position_sigma ? 1 : 0;
    squares += error_m * error_m / kSorties;
    stated += scene.position_sigma * scene.position_sigma / kSorties;
  }
  std::cout << GetParam().name << ": error " << std::sqrt(squares) << " m, stated " << std::sqrt(stated) << " m, within one / two sigma "
            << within_one << " / " << within_two << " of " << kSorties << "\n";
  EXPECT_GE(within_one, 41);
  EXPECT_LE(within_one, 67) << "sigmas are too large";
  EXPECT_GE(within_two, 70);
}

INSTANTIATE_TEST_SUITE_P(Flights, StatedSigma,
                         ::testing::Values(SigmaCase{"Nadir", -90.0, 8.0, 0, Boresight::kWhereSeen},
                                           SigmaCase{"Oblique", -45.0, 5.0, 0, Boresight::kWhereSeen},
                                           SigmaCase{"WideOblique", -60.0, 50.0, 0, Boresight::kWhereSeen},
                                           SigmaCase{"TwoLegs", -90.0, 8.0, 10, Boresight::kWhereSeen},
                                           SigmaCase{"BoresightEstimated", -60.0, 50.0, 0, Boresight::kEstimated},
                                           SigmaCase{"FourControlPoints", -90.0, 8.0, 0, Boresight::kWhereSeen, true}),
                         [](const auto& instance) { return instance.param.name; });

TEST(Align, BalancesGainsAndOffsetsUpToOneCommonPair) {
  SyntheticOptions options;
  options.gain_sigma = 0.1;
  options.offset_sigma = 8.0;
  const SyntheticSortie sortie = MakeSortie(options);
  const AlignSolution solution = MustAlign(sortie.input);
  // balanced = a (G_s ground + O_s) + b has to be one and the same function of the ground for every scene.
  std::vector<double> dark, bright;
  for (const AlignedScene& scene : solution.scenes) {
    const auto at = [&](double ground) {
      return scene.balanced_from_scene.gain * (sortie.scene_gain[scene.window_id] * ground + sortie.scene_offset[scene.window_id]) +
             scene.balanced_from_scene.offset;
    };
    dark.push_back(at(64.0));
    bright.push_back(at(192.0));
  }
  for (const auto& values : {dark, bright}) {
    const auto [low, high] = std::minmax_element(values.begin(), values.end());
    EXPECT_LT(*high - *low, 0.8) << "grey levels, of frames that differ by tens";
  }
  const double slope = (bright[0] - dark[0]) / 128.0;
  EXPECT_NEAR(slope, 1.0, 0.1) << "gauge: frames' gains average to 1";
}

TEST(Align, FailsClearlyWithoutAnyScene) {
  AlignInput input;
  input.width_px = 10;
  input.height_px = 10;
  const auto solution = Align(input, {}, nullptr, nullptr);
  ASSERT_FALSE(solution.ok());
  EXPECT_EQ(solution.status().code(), StatusCode::kFailed);
}

TEST(Align, StopsWhenAsked) {
  const SyntheticSortie sortie = MakeSortie({});
  const auto solution = Align(sortie.input, {}, nullptr, [](double) { return false; });
  ASSERT_FALSE(solution.ok());
  EXPECT_EQ(solution.status().code(), StatusCode::kCancelled);
}

}  // namespace
}  // namespace trem::align
