#pragma once

#include <cstdint>
#include <vector>

#include "mosaic/base/status.h"
#include "mosaic/geometry/roi.h"
#include "proto/trem/v1/job.pb.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// What one Enhance task reconstructs: a rectangle of the sensor over a run of frames.
struct WindowPlan {
  std::uint32_t window_id = 0;    // 0 .. n-1 in the order (span, time, ROI row, ROI column).
  Roi roi_in_sensor;              // Sensor pixels.
  std::uint32_t frame_begin = 0;  // Half-open range of manifest frame indices.
  std::uint32_t frame_end = 0;
};

// A half-open interval [begin, end).
struct Interval {
  std::int64_t begin = 0;
  std::int64_t end = 0;
  std::int64_t length() const { return end - begin; }
  friend bool operator==(const Interval&, const Interval&) = default;
};

// Covers [0, extent) with the fewest intervals of length at most `length_max` of which neighbours share at least `overlap`:
//
//   n = 1                                              when extent <= length_max
//   n = ceil((extent - overlap) / (length_max - overlap))  otherwise
//
// All have one length L, the smallest that covers: ceil((extent + (n-1) overlap) / n), but at least `length_min`, and made odd when
// `prefer_odd` and L+1 still fits; they begin at floor(i (extent - L) / (n-1)). What is left over is thus spread evenly over the
// overlaps. Because n > extent / length_max, L is more than half of length_max.
// Preconditions (checked): extent >= 1, 0 <= overlap < length_max, length_min <= length_max.
std::vector<Interval> CoverEvenly(std::int64_t extent, std::int64_t length_max, std::int64_t overlap, std::int64_t length_min,
                                  bool prefer_odd);

// The least side of a ROI, sensor pixels: registration of six affine parameters needs about this many.
inline constexpr int kRoiSideMin = 24;
// More windows than this in one job are refused: the plan, the log and every ALIGN message grow with them.
inline constexpr std::int64_t kWindowsMax = 1'000'000;

// Tiles `ingest.valid_roi` in space and every span of `ingest` in time (windows never straddle two spans).
// `sortie` is complete: every default filled in. kInvalidInput when there is nothing to plan or a field is out of range (the message
// names it), kCorrupt when `ingest` contradicts itself.
Result<std::vector<WindowPlan>> PlanWindows(const v1::Sortie& sortie, const v1::IngestSummary& ingest);

}  // namespace trem
