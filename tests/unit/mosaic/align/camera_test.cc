// Goal: what is known of the camera and of the ground is used: control points pin the mosaic down and are checked, wrong ones are named,
// slopes are met where they are, and focal length and distortion of the lens are found. Method: chains simulated from true cameras
// (synthetic.h), recovered maps against the truth.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <iostream>

#include "mosaic/align/align.h"
#include "mosaic/align/relief.h"
#include "tests/unit/mosaic/align/synthetic.h"

namespace trem::align {
namespace {

using ::testing::ElementsAre;

AlignSolution MustAlign(const AlignInput& input) {
  Result<AlignSolution> solution = Align(input, {}, nullptr, nullptr);
  EXPECT_TRUE(solution.ok()) << solution.status().ToString();
  return solution.ok() ? *solution : AlignSolution{};
}

Eigen::Vector2d CentreOf(const Roi& roi) { return {0.5 * (roi.x0 + roi.x1 - 1), 0.5 * (roi.y0 + roi.y1 - 1)}; }

// Rms error of the scenes' centres, sensor pixels.
double RmsErrorPx(const SyntheticSortie& sortie, const AlignSolution& solution) {
  double squares = 0.0;
  for (const AlignedScene& scene : solution.scenes) {
    const Eigen::Vector2d x = CentreOf(scene.roi_in_scene);
    squares += (scene.world_from_scene * x - sortie.world_from_scene[scene.window_id] * x).squaredNorm();
  }
  return std::sqrt(squares / static_cast<double>(solution.scenes.size())) / sortie.gsd_m;
}

SyntheticOptions Biased() {
  SyntheticOptions options;
  options.position_bias_m = 2.0;
  options.attitude_bias_deg = 0.1;
  options.attitude_white_deg = 0.03;
  return options;
}

TEST(Control, FourPointsPinTheMosaicToAThirdOfAPixel) {
  for (const double pitch_deg : {-90.0, -45.0}) {
    SyntheticOptions options = Biased();
    options.pitch_deg = pitch_deg;
    SyntheticSortie sortie = MakeSortie(options);
    const AlignSolution without = MustAlign(sortie.input);
    EXPECT_GT(RmsErrorPx(sortie, without), 1.0) << "negative control: telemetry's shared errors";
    sortie.input.control = FourPoints(options, sortie);
    ASSERT_GE(sortie.input.control.size(), 8U);
    sortie.input.control_sigma_px = 0.2;
    sortie.input.control_sigma_m = 0.01;
    const AlignSolution with = MustAlign(sortie.input);
    EXPECT_LT(RmsErrorPx(sortie, with), 0.33);
    EXPECT_EQ(with.control.constraints.point_count, 4);
    EXPECT_LT(with.control.constraints.rmse_m, 0.33 * sortie.gsd_m);
    EXPECT_EQ(with.control.checks.point_count, 0);
    // And it says so.
    EXPECT_LT(with.scenes[0].position_sigma, 0.3 * without.scenes[0].position_sigma);
  }
}

TEST(Control, HeldOutPointsMeasureTheErrorAndDoNotChangeTheResult) {
  const SyntheticOptions options = Biased();
  SyntheticSortie sortie = MakeSortie(options);
  const AlignSolution without = MustAlign(sortie.input);
  sortie.input.control = FourPoints(options, sortie);
  for (ControlObservation& control : sortie.input.control) control.held_out = true;
  const AlignSolution checked = MustAlign(sortie.input);
  EXPECT_EQ(checked.control.constraints.point_count, 0);
  EXPECT_EQ(checked.control.checks.point_count, 4);
  // The points lie all over the mosaic, which is off as a whole.
  EXPECT_NEAR(checked.control.checks.rmse_m, RmsErrorPx(sortie, without) * sortie.gsd_m, 0.4);
  EXPECT_NEAR(checked.control.checks.ce90_m, 1.5175 * checked.control.checks.rmse_m, 1e-9);
  EXPECT_NEAR(RmsErrorPx(sortie, checked), RmsErrorPx(sortie, without), 0.05);
}

TEST(Control, APointOneKilometreOffIsNamedAndTheOthersServe) {
  const SyntheticOptions options = Biased();
  SyntheticSortie sortie = MakeSortie(options);
  sortie.input.control = FourPoints(options, sortie);
  for (ControlObservation& control : sortie.input.control) {
    if (control.name == "P2") control.x_in_world += Eigen::Vector3d(700.0, -714.0, 0.0);
  }
  const AlignSolution solution = MustAlign(sortie.input);
  std::vector<std::string> outliers;
  for (const AlignedControl& control : solution.control.observations) {
    if (!control.outlier || (!outliers.empty() && outliers.back() == control.name)) continue;
    outliers.push_back(control.name);
    EXPECT_NEAR(control.error_m.norm(), 1000.0, 5.0);
  }
  EXPECT_THAT(outliers, ElementsAre("P2"));
  EXPECT_EQ(solution.control.constraints.point_count, 3);
  EXPECT_LT(RmsErrorPx(sortie, solution), 0.7);
}

TEST(Control, PointsInFramesThatAreNotPlacedAreListed) {
  const SyntheticOptions options;
  SyntheticSortie sortie = MakeSortie(options);
  sortie.input.control = {{"Lost", 4000, {10.0, 10.0}, {0.0, 0.0, 0.0}, false}};
  EXPECT_THAT(MustAlign(sortie.input).control.unseen, ElementsAre("Lost"));
}

TEST(Ground, SlopesAreMetWhereTheyAre) {
  SyntheticOptions options;
  options.slope = 0.1;
  options.pitch_deg = -60.0;
  SyntheticSortie sortie = MakeSortie(options);
  EXPECT_LT(RmsErrorPx(sortie, MustAlign(sortie.input)), 0.2);
  sortie.input.ground = nullptr;
  EXPECT_GT(RmsErrorPx(sortie, MustAlign(sortie.input)), 2.0) << "negative control: level ground";
}

// Rms error of places all over the scenes, sensor pixels.
double RmsOverHillsPx(const SyntheticSortie& sortie, const AlignSolution& solution) {
  double squares = 0.0, count = 0.0;
  for (const AlignedScene& scene : solution.scenes) {
    const Roi& roi = scene.roi_in_scene;
    for (const double x : {roi.x0 + 20.0, 0.5 * (roi.x0 + roi.x1), roi.x1 - 20.0}) {
      for (const double y : {roi.y0 + 20.0, 0.5 * (roi.y0 + roi.y1), roi.y1 - 20.0}) {
        const Eigen::Vector2d c(x, y);
        const Eigen::Vector2d found = scene.world_from_scene * Unshifted(scene.shifts, c);
        squares += (found - sortie.PlaceOfCell(scene.window_id, c)).squaredNorm();
        count += 1.0;
      }
    }
  }
  return std::sqrt(squares / count) / sortie.gsd_m;
}

// Hills that are no plane under a scene, seen from 400 m at an angle: what a homography leaves is found from the cameras.
TEST(Ground, HillsAreMetWhereTheyAre) {
  SyntheticOptions options;
  options.hills_m = 4.0;
  options.pitch_deg = -60.0;
  SyntheticSortie sortie = MakeSortie(options);
  AlignSolution solution = MustAlign(sortie.input);
  const double with_shifts = RmsOverHillsPx(sortie, solution);
  for (AlignedScene& scene : solution.scenes) scene.shifts = {};
  const double without = RmsOverHillsPx(sortie, solution);
  EXPECT_LT(with_shifts, 0.6);
  EXPECT_GT(without, 3.0 * with_shifts) << "negative control: homographies alone";
  std::cout << "rms error over hills " << with_shifts << " px, by homographies alone " << without << " px\n";
}

// What affine views can't follow makes ties less sure, in proportion to the hills; on a slope they follow everything.
TEST(Ground, TiesAreLessSureTheHigherTheHills) {
  const auto relief_px = [](double hills_m, double slope) {
    SyntheticOptions options;
    options.hills_m = hills_m;
    options.slope = slope;
    const AlignGraph graph = BuildAlignGraph(MakeSortie(options).input, {});
    AlignState state = InitialState(graph);
    UpdateShifts(graph, Shifts::kRelief, state);
    double sum = 0.0;
    for (const double px : state.tie_relief_px) sum += px / static_cast<double>(state.tie_relief_px.size());
    return sum;
  };
  EXPECT_EQ(relief_px(0.0, 0.0), 0.0);
  EXPECT_LT(relief_px(0.0, 0.1), 0.01);
  const double low = relief_px(1.0, 0.0);
  EXPECT_GT(low, 0.02);
  EXPECT_NEAR(relief_px(2.0, 0.0), 2.0 * low, 0.2 * low);
}

TEST(Lens, AWrongFocalLengthIsFoundInAWideObliqueView) {
  SyntheticOptions options;
  options.pitch_deg = -60.0;
  options.hfov_deg = 50.0;
  options.focal_error = 0.01;
  options.projective_views = true;
  options.speed_m = 8.0;
  SyntheticSortie sortie = MakeSortie(options);
  const double trusted_px = RmsErrorPx(sortie, MustAlign(sortie.input));
  sortie.input.focal_sigma = 0.01;
  const AlignSolution found = MustAlign(sortie.input);
  EXPECT_NEAR(found.lens.log_focal, -std::log(1.01), 0.0025);
  EXPECT_LT(RmsErrorPx(sortie, found), 0.5 * trusted_px);
}

// A ROI's own views say nothing of distortion, which is the same in all of them: control points across the image do.
TEST(Lens, DistortionIsFoundFromControlPointsWhenAsked) {
  SyntheticOptions options;
  options.hfov_deg = 40.0;
  options.speed_m = 6.0;
  options.k1 = -0.08;
  SyntheticSortie sortie = MakeSortie(options);
  for (int k = 0; k < 12; ++k) {
    const Eigen::Vector2d u(20.0 + 70.0 * (k % 4), 20.0 + 75.0 * (k / 4));
    const auto seen = ObserveControl(options, sortie, "P" + std::to_string(k), sortie.world_from_sensor[15] * u, 0.2);
    sortie.input.control.insert(sortie.input.control.end(), seen.begin(), seen.end());
  }
  sortie.input.control_sigma_px = 0.2;
  sortie.input.control_sigma_m = 0.02;
  const AlignSolution ignored = MustAlign(sortie.input);
  EXPECT_EQ(ignored.lens.k1, 0.0);
  sortie.input.estimate_distortion = true;
  const AlignSolution found = MustAlign(sortie.input);
  EXPECT_NEAR(found.lens.k1, -0.08, 0.008);
  EXPECT_LT(found.control.constraints.rmse_m, 0.5 * ignored.control.constraints.rmse_m);
}

}  // namespace
}  // namespace trem::align
