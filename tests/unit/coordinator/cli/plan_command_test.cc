// Goal: the printed plan is the planner's. Method: a manifest made by hand: 100 frames of 256 x 200 px that move by (3, 4) px each.
#include "coordinator/cli/plan_command.h"

#include <gtest/gtest.h>

#include "coordinator/planning/window_plan.h"
#include "proto/codec/sortie_spec.h"

namespace trem {
namespace {

v1::SortieManifest MovingManifest() {
  v1::SortieManifest manifest;
  manifest.set_width_px(256);
  manifest.set_height_px(200);
  manifest.mutable_valid_roi()->set_x1(256);
  manifest.mutable_valid_roi()->set_y1(200);
  for (int i = 0; i < 101; ++i) {
    v1::ManifestFrame* frame = manifest.add_frames();
    frame->set_state(i == 50 ? v1::FRAME_UNREADABLE : v1::FRAME_USABLE);
    if (i == 0 || i == 50) continue;
    frame->set_motion_correlation(0.9);
    for (const double number : {1.0, 0.0, 3.0, 0.0, 1.0, 4.0}) frame->add_previous_from_current(number);
  }
  v1::FrameSpan* span = manifest.add_spans();
  span->set_end(101);
  return manifest;
}

TEST(IngestSummaryFromManifest, CountsUsableFramesAndTakesTheMedianMotion) {
  const v1::IngestSummary summary = IngestSummaryFromManifest(MovingManifest());
  EXPECT_EQ(summary.frame_count(), 101u);
  EXPECT_EQ(summary.usable_frame_count(), 100u);
  EXPECT_DOUBLE_EQ(summary.median_motion_px(), 5.0);
}

TEST(MakePlanReport, CountsWindowsAsThePlannerDoes) {
  v1::Sortie sortie;
  sortie.mutable_source()->set_path("/frames");
  ASSERT_TRUE(CompleteSortie(&sortie).ok());
  const auto windows = PlanWindows(sortie, IngestSummaryFromManifest(MovingManifest()));
  ASSERT_TRUE(windows.ok()) << windows.status().ToString();
  const auto plan = MakePlanReport(sortie, MovingManifest());
  ASSERT_TRUE(plan.ok()) << plan.status().ToString();
  EXPECT_EQ(plan->window_count, windows->size());
  EXPECT_GT(plan->roi_count, 0u);
  EXPECT_LE(plan->roi_count, plan->window_count);
  EXPECT_GT(plan->enhance_memory_bytes, 0u);
  EXPECT_GT(plan->disk_bytes, 0u);
}

TEST(MakePlanReport, RefusesASortieWithoutFrames) {
  v1::Sortie sortie;
  sortie.mutable_source()->set_path("/frames");
  ASSERT_TRUE(CompleteSortie(&sortie).ok());
  EXPECT_FALSE(MakePlanReport(sortie, v1::SortieManifest()).ok());
}

}  // namespace
}  // namespace trem
