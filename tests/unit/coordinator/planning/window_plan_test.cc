// Goal: the window plan covers everything, overlaps enough and obeys its limits. Method: brute force over many sizes, counting every
// pixel and every frame; a few plans by hand; every bad option must be named in its error.
#include "coordinator/planning/window_plan.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <set>
#include <utility>

#include "mosaic/base/rng.h"

namespace trem {
namespace {

v1::Sortie MakeSortie(unsigned roi_px, unsigned roi_overlap_px, unsigned frames, unsigned frame_overlap) {
  v1::Sortie sortie;
  sortie.mutable_windows()->set_roi_px(roi_px);
  sortie.mutable_windows()->set_roi_overlap_px(roi_overlap_px);
  sortie.mutable_windows()->set_frames(frames);
  sortie.mutable_windows()->set_frame_overlap(frame_overlap);
  return sortie;
}

v1::IngestSummary MakeIngest(const Roi& valid_roi, const std::vector<std::pair<unsigned, unsigned>>& spans) {
  v1::IngestSummary ingest;
  ingest.set_width_px(static_cast<unsigned>(valid_roi.x1 + 3));
  ingest.set_height_px(static_cast<unsigned>(valid_roi.y1 + 5));
  ingest.mutable_valid_roi()->set_x0(valid_roi.x0);
  ingest.mutable_valid_roi()->set_y0(valid_roi.y0);
  ingest.mutable_valid_roi()->set_x1(valid_roi.x1);
  ingest.mutable_valid_roi()->set_y1(valid_roi.y1);
  for (const auto& [begin, end] : spans) {
    v1::FrameSpan* span = ingest.add_spans();
    span->set_begin(begin);
    span->set_end(end);
    ingest.set_frame_count(std::max(ingest.frame_count(), end));
    ingest.set_usable_frame_count(ingest.usable_frame_count() + end - begin);
  }
  return ingest;
}

TEST(CoverEvenlyTest, KeepsEveryPromiseForEverySmallCase) {
  for (std::int64_t length_max = 1; length_max <= 14; ++length_max) {
    for (std::int64_t overlap = 0; overlap < length_max; ++overlap) {
      for (std::int64_t extent = 1; extent <= 60; ++extent) {
        for (const bool prefer_odd : {false, true}) {
          SCOPED_TRACE(testing::Message() << "extent " << extent << " length_max " << length_max << " overlap " << overlap);
          const std::vector<Interval> intervals = CoverEvenly(extent, length_max, overlap, 1, prefer_odd);
          ASSERT_EQ(intervals.front().begin, 0);
          ASSERT_EQ(intervals.back().end, extent);
          for (const Interval& interval : intervals) {
            ASSERT_LE(interval.length(), length_max);
            ASSERT_EQ(interval.length(), intervals.front().length());
            ASSERT_TRUE(extent <= length_max || 2 * interval.length() > length_max);
          }
          std::int64_t shared_min = extent;
          std::int64_t shared_max = 0;
          for (std::size_t i = 1; i < intervals.size(); ++i) {
            const std::int64_t shared = intervals[i - 1].end - intervals[i].begin;
            shared_min = std::min(shared_min, shared);
            shared_max = std::max(shared_max, shared);
            ASSERT_GT(intervals[i].begin, intervals[i - 1].begin);
          }
          if (intervals.size() > 1) {
            ASSERT_GE(shared_min, overlap);
            ASSERT_LE(shared_max - shared_min, 1) << "what is left over is not spread evenly";
          }
          // No cover with fewer intervals exists: n intervals reach at most n (length_max - overlap) + overlap.
          const std::int64_t fewer = static_cast<std::int64_t>(intervals.size()) - 1;
          ASSERT_TRUE(fewer == 0 || fewer * (length_max - overlap) + overlap < extent);
        }
      }
    }
  }
}

TEST(CoverEvenlyTest, PrefersOddLengthsWhereTheyFit) {
  const std::vector<Interval> intervals = CoverEvenly(256, 201, 40, 24, true);
  ASSERT_EQ(intervals.size(), 2U);
  EXPECT_EQ(intervals[0].length(), 149);
  EXPECT_EQ(intervals[1], (Interval{107, 256}));
}

TEST(WindowPlanTest, CoversEveryPixelOfEveryFrameOfRandomSorties) {
  for (std::uint64_t seed = 0; seed < 60; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    Rng rng({seed, 17});
    const unsigned roi_px = 24 + rng.UniformIndex(40);
    const unsigned frames = 1 + rng.UniformIndex(12);
    const v1::Sortie sortie = MakeSortie(roi_px, rng.UniformIndex(roi_px), frames, rng.UniformIndex(frames));
    const int x0 = static_cast<int>(rng.UniformIndex(5));
    const int y0 = static_cast<int>(rng.UniformIndex(5));
    const Roi valid{x0, y0, x0 + 24 + static_cast<int>(rng.UniformIndex(80)), y0 + 24 + static_cast<int>(rng.UniformIndex(80))};
    std::vector<std::pair<unsigned, unsigned>> spans;
    unsigned next = rng.UniformIndex(3);
    for (unsigned i = 0; i < 1 + rng.UniformIndex(3); ++i) {
      const unsigned end = next + 1 + rng.UniformIndex(25);
      spans.push_back({next, end});
      next = end + rng.UniformIndex(4);
    }
    const auto plan = PlanWindows(sortie, MakeIngest(valid, spans));
    ASSERT_TRUE(plan.ok()) << plan.status().ToString();

    std::set<std::pair<unsigned, std::pair<int, int>>> uncovered;
    for (const auto& [begin, end] : spans) {
      for (unsigned frame = begin; frame < end; ++frame) {
        for (int y = valid.y0; y < valid.y1; y += 7) {
          for (int x = valid.x0; x < valid.x1; x += 7) uncovered.insert({frame, {x, y}});
        }
        uncovered.insert({frame, {valid.x1 - 1, valid.y1 - 1}});
      }
    }
    std::uint32_t expected_id = 0;
    for (const WindowPlan& window : *plan) {
      EXPECT_EQ(window.window_id, expected_id++);
      EXPECT_TRUE(valid.Contains(window.roi_in_sensor));
      EXPECT_LE(window.roi_in_sensor.width(), static_cast<int>(roi_px));
      EXPECT_LE(window.roi_in_sensor.height(), static_cast<int>(roi_px));
      EXPECT_GE(window.roi_in_sensor.width(), kRoiSideMin);
      EXPECT_GE(window.roi_in_sensor.height(), kRoiSideMin);
      EXPECT_LE(window.frame_end - window.frame_begin, frames);
      EXPECT_EQ(std::count_if(spans.begin(), spans.end(),
                              [&](const auto& span) { return window.frame_begin >= span.first && window.frame_end <= span.second; }),
                1)
          << "a window straddles two spans";
      for (auto it = uncovered.begin(); it != uncovered.end();) {
        const bool covered = it->first >= window.frame_begin && it->first < window.frame_end &&
                             window.roi_in_sensor.Contains(it->second.first, it->second.second);
        it = covered ? uncovered.erase(it) : std::next(it);
      }
    }
    EXPECT_TRUE(uncovered.empty()) << uncovered.size() << " samples are in no window";
  }
}

TEST(WindowPlanTest, NumbersWindowsBySpanThenTimeThenRowThenColumn) {
  const auto plan = PlanWindows(MakeSortie(50, 10, 20, 5), MakeIngest({0, 0, 90, 90}, {{0, 30}, {31, 40}}));
  ASSERT_TRUE(plan.ok());
  ASSERT_EQ(plan->size(), 12U);  // (2 + 1) ranges of frames, 2 x 2 ROIs.
  EXPECT_TRUE(std::is_sorted(plan->begin(), plan->end(), [](const WindowPlan& a, const WindowPlan& b) {
    return std::tuple(a.frame_begin, a.roi_in_sensor.y0, a.roi_in_sensor.x0) <
           std::tuple(b.frame_begin, b.roi_in_sensor.y0, b.roi_in_sensor.x0);
  }));
  EXPECT_EQ((*plan)[11].frame_begin, 31U);
  EXPECT_EQ((*plan)[11].frame_end, 40U);
}

TEST(WindowPlanTest, MakesOneWindowOfAShortSmallSortie) {
  const auto plan = PlanWindows(MakeSortie(201, 40, 96, 24), MakeIngest({2, 3, 180, 150}, {{0, 96}}));
  ASSERT_TRUE(plan.ok());
  ASSERT_EQ(plan->size(), 1U);
  EXPECT_EQ((*plan)[0].roi_in_sensor, (Roi{2, 3, 180, 150}));
}

TEST(WindowPlanTest, NamesTheFieldOfABadOption) {
  const v1::IngestSummary ingest = MakeIngest({0, 0, 100, 100}, {{0, 10}});
  const auto message = [&](const v1::Sortie& sortie) { return PlanWindows(sortie, ingest).status().ToString(); };
  EXPECT_THAT(message(MakeSortie(10, 2, 20, 5)), testing::HasSubstr("windows.roi_px is 10"));
  EXPECT_THAT(message(MakeSortie(50, 50, 20, 5)), testing::HasSubstr("windows.roi_overlap_px is 50"));
  EXPECT_THAT(message(MakeSortie(50, 5, 0, 0)), testing::HasSubstr("windows.frames is 0"));
  EXPECT_THAT(message(MakeSortie(50, 5, 20, 20)), testing::HasSubstr("windows.frame_overlap is 20"));
}

TEST(WindowPlanTest, RefusesWhatCannotBePlanned) {
  const v1::Sortie sortie = MakeSortie(50, 10, 20, 5);
  EXPECT_EQ(PlanWindows(sortie, MakeIngest({0, 0, 100, 100}, {})).status().code(), StatusCode::kInvalidInput);
  EXPECT_EQ(PlanWindows(sortie, MakeIngest({0, 0, 20, 100}, {{0, 10}})).status().code(), StatusCode::kInvalidInput);
  EXPECT_EQ(PlanWindows(sortie, MakeIngest({0, 0, 100, 100}, {{5, 10}, {4, 12}})).status().code(), StatusCode::kCorrupt);
  v1::IngestSummary beyond = MakeIngest({0, 0, 100, 100}, {{0, 10}});
  beyond.mutable_valid_roi()->set_x1(1000);
  EXPECT_EQ(PlanWindows(sortie, beyond).status().code(), StatusCode::kCorrupt);
}

TEST(WindowPlanTest, RefusesMoreWindowsThanTheLimit) {
  const auto plan = PlanWindows(MakeSortie(24, 23, 2, 1), MakeIngest({0, 0, 1024, 1024}, {{0, 100}}));
  ASSERT_FALSE(plan.ok());
  EXPECT_THAT(plan.status().message(), testing::HasSubstr("more than 1000000 windows"));
}

}  // namespace
}  // namespace trem
