#include "coordinator/planning/window_plan.h"

#include <algorithm>
#include <string>

#include "mosaic/base/check.h"

namespace trem {
namespace {

std::int64_t CeilDivide(std::int64_t numerator, std::int64_t denominator) { return (numerator + denominator - 1) / denominator; }

Status CheckWindowOptions(const v1::Windows& windows) {
  if (windows.roi_px() < static_cast<unsigned>(kRoiSideMin)) {
    return InvalidInput("windows.roi_px is " + std::to_string(windows.roi_px()) + "; expected at least " + std::to_string(kRoiSideMin));
  }
  if (windows.roi_overlap_px() >= windows.roi_px()) {
    return InvalidInput("windows.roi_overlap_px is " + std::to_string(windows.roi_overlap_px()) +
                        "; expected less than windows.roi_px = " + std::to_string(windows.roi_px()));
  }
  if (windows.frames() < 1) return InvalidInput("windows.frames is 0; expected at least 1");
  if (windows.frame_overlap() >= windows.frames()) {
    return InvalidInput("windows.frame_overlap is " + std::to_string(windows.frame_overlap()) +
                        "; expected less than windows.frames = " + std::to_string(windows.frames()));
  }
  return {};
}

Status CheckIngest(const v1::IngestSummary& ingest, const Roi& valid_roi) {
  const Roi image{0, 0, static_cast<int>(std::min<std::uint32_t>(ingest.width_px(), 1U << 20)),
                  static_cast<int>(std::min<std::uint32_t>(ingest.height_px(), 1U << 20))};
  if (valid_roi.empty() || !image.Contains(valid_roi)) {
    return Corrupt("the ingest summary's valid_roi " + ToString(valid_roi) + " is not within its image " + ToString(image));
  }
  if (valid_roi.width() < kRoiSideMin || valid_roi.height() < kRoiSideMin) {
    return InvalidInput("the usable part of the frames is " + std::to_string(valid_roi.width()) + " x " +
                        std::to_string(valid_roi.height()) + " px; at least " + std::to_string(kRoiSideMin) + " px a side are needed");
  }
  std::uint32_t previous_end = 0;
  for (const v1::FrameSpan& span : ingest.spans()) {
    if (span.begin() < previous_end || span.end() <= span.begin() || span.end() > ingest.frame_count()) {
      return Corrupt("the ingest summary's span [" + std::to_string(span.begin()) + "," + std::to_string(span.end()) +
                     ") is empty, out of order or beyond its " + std::to_string(ingest.frame_count()) + " frames");
    }
    previous_end = span.end();
  }
  if (ingest.spans().empty()) {
    return InvalidInput("the sortie has no usable frame that fits its neighbour among its " + std::to_string(ingest.frame_count()) +
                        " frames; at least two successive ones are needed (`trem inspect` says what was found)");
  }
  return {};
}

}  // namespace

std::vector<Interval> CoverEvenly(std::int64_t extent, std::int64_t length_max, std::int64_t overlap, std::int64_t length_min,
                                  bool prefer_odd) {
  TREM_CHECK(extent >= 1 && overlap >= 0 && overlap < length_max && length_min <= length_max);
  if (extent <= length_max) return {{0, extent}};
  const std::int64_t count = CeilDivide(extent - overlap, length_max - overlap);
  std::int64_t length = std::max(CeilDivide(extent + (count - 1) * overlap, count), length_min);
  if (prefer_odd && length % 2 == 0 && length + 1 <= length_max) ++length;
  std::vector<Interval> intervals;
  intervals.reserve(static_cast<std::size_t>(count));
  for (std::int64_t i = 0; i < count; ++i) {
    const std::int64_t begin = i * (extent - length) / (count - 1);
    intervals.push_back({begin, begin + length});
  }
  return intervals;
}

Result<std::vector<WindowPlan>> PlanWindows(const v1::Sortie& sortie, const v1::IngestSummary& ingest) {
  const v1::Windows& options = sortie.windows();
  TREM_RETURN_IF_ERROR(CheckWindowOptions(options));
  const v1::RoiMessage& message = ingest.valid_roi();
  const Roi valid_roi{message.x0(), message.y0(), message.x1(), message.y1()};
  TREM_RETURN_IF_ERROR(CheckIngest(ingest, valid_roi));

  const std::vector<Interval> columns = CoverEvenly(valid_roi.width(), options.roi_px(), options.roi_overlap_px(), kRoiSideMin, true);
  const std::vector<Interval> rows = CoverEvenly(valid_roi.height(), options.roi_px(), options.roi_overlap_px(), kRoiSideMin, true);
  std::vector<WindowPlan> windows;
  for (const v1::FrameSpan& span : ingest.spans()) {
    const std::int64_t span_frames = static_cast<std::int64_t>(span.end()) - span.begin();
    for (const Interval& frames : CoverEvenly(span_frames, options.frames(), options.frame_overlap(), 1, false)) {
      for (const Interval& row : rows) {
        for (const Interval& column : columns) {
          WindowPlan window;
          window.window_id = static_cast<std::uint32_t>(windows.size());
          window.roi_in_sensor = {valid_roi.x0 + static_cast<int>(column.begin), valid_roi.y0 + static_cast<int>(row.begin),
                                  valid_roi.x0 + static_cast<int>(column.end), valid_roi.y0 + static_cast<int>(row.end)};
          window.frame_begin = span.begin() + static_cast<std::uint32_t>(frames.begin);
          window.frame_end = span.begin() + static_cast<std::uint32_t>(frames.end);
          windows.push_back(window);
        }
      }
      if (static_cast<std::int64_t>(windows.size()) > kWindowsMax) {
        return InvalidInput("the plan has more than " + std::to_string(kWindowsMax) +
                            " windows; raise windows.roi_px or windows.frames, lower their overlaps, or use fewer frames");
      }
    }
  }
  return windows;
}

}  // namespace trem
