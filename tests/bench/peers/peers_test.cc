// Goal: the benches' instruments read what is there: bars that are there, that are not, that are reversed; answers that lie elsewhere; and
// conventions of views that the peers with true registration rely on. Method: scenes made for the purpose.
#include <gtest/gtest.h>

#include "tests/bench/peers/bar_chart.h"
#include "tests/bench/peers/wiener.h"
#include "worker/simulate/truth.h"

namespace trem::bench {
namespace {

testing::SequenceOptions Dwell(int roi_px, int frame_count) {
  testing::SequenceOptions options;
  options.motion = testing::CameraMotion::kDwell;
  options.frame_count = frame_count;
  options.roi_px = roi_px;
  options.speed_px = 0.02;
  options.psf_sigma_px = 0.6;
  return options;
}

BenchScene Procedural(int roi_px, int frame_count) {
  const testing::SequenceOptions options = Dwell(roi_px, frame_count);
  return MakeBenchScene("", false, ProceduralTerrain(testing::TruthWidth(options), testing::TruthHeight(options), 1, 4), options);
}

TEST(BarChart, TheTruthResolvesEveryBoardAndOneFrameNoneBeyondItsNyquistFrequency) {
  const BarChart chart = MakeBarChart(Dwell(151, 1));
  EXPECT_DOUBLE_EQ(HighestResolved(chart.scene.target, chart), 1.0);
  const double of_a_frame = HighestResolved(Bicubic(chart.scene), chart);
  EXPECT_GE(of_a_frame, 0.35);
  EXPECT_LE(of_a_frame, 0.5);
}

TEST(BarChart, FlatGreyAndReversedBarsAreNotResolved) {
  const BarChart chart = MakeBarChart(Dwell(151, 1));
  const Image<float> flat(chart.scene.AnswerSide(), chart.scene.AnswerSide(), 100.0F);
  EXPECT_DOUBLE_EQ(HighestResolved(flat, chart), 0.0);
  Image<float> reversed = chart.scene.target;
  for (float& value : reversed.pixels()) value = 255.0F - value;
  EXPECT_DOUBLE_EQ(HighestResolved(reversed, chart), 0.0);
  EXPECT_LT(ReadBars(reversed, chart.boards[0]).modulation, -0.5);
}

TEST(BenchScene, AShiftedAnswerIsFoundWhereItLies) {
  const BenchScene scene = Procedural(61, 1);
  Image<float> shifted(scene.AnswerSide(), scene.AnswerSide());
  for (int y = 0; y < shifted.height(); ++y) {
    for (int x = 0; x < shifted.width(); ++x) shifted.at(x, y) = SampleClamped(scene.target, x + 1.25, y - 0.5);
  }
  const ShiftedScore best = ScoreAtBestShift(scene, shifted, 0.0, 0.0);
  EXPECT_NEAR(best.shift_x, 1.25, 0.15);
  EXPECT_NEAR(best.shift_y, -0.5, 0.15);
  EXPECT_GT(best.db, Score(scene, shifted) + 5.0);
}

TEST(BenchScene, FramesFallWhereTheTrueViewsSay) {
  const BenchScene scene = Procedural(61, 24);
  // A wrong sign or half a cell in the views would leave shift-and-add no sharper than one frame.
  const double fused = TunedWiener(scene, ShiftAndAdd(scene)).db;
  const double one_frame = TunedWiener(scene, Bicubic(scene)).db;
  EXPECT_GT(fused, one_frame + 2.0);
  EXPECT_GT(one_frame, Score(scene, Bicubic(scene)) + 0.5);
}

}  // namespace
}  // namespace trem::bench
