#pragma once

#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// What a job would do, without doing it.
struct PlanReport {
  std::uint32_t frame_count = 0;
  std::uint32_t usable_frame_count = 0;
  std::uint32_t span_count = 0;
  std::uint32_t width_px = 0;
  std::uint32_t height_px = 0;
  std::size_t window_count = 0;
  std::size_t roi_count = 0;              // Distinct rectangles of the sensor.
  std::uint64_t ingest_memory_bytes = 0;  // Bounds for one task of each kind, as the planner states them.
  std::uint64_t enhance_memory_bytes = 0;
  std::uint64_t composite_memory_bytes = 0;
  std::uint64_t disk_bytes = 0;  // Rough size of the scene rasters in the artefact store.
};

// The planner's input, as an INGEST task would report it.
v1::IngestSummary IngestSummaryFromManifest(const v1::SortieManifest& manifest);

// Errors as PlanWindows.
Result<PlanReport> MakePlanReport(const v1::Sortie& sortie, const v1::SortieManifest& manifest);

// `trem plan`: reads the sortie (by way of trem-worker) and prints the plan. Returns the exit code.
int RunPlanCommand(const std::string& sortie, const std::vector<std::string>& overrides, bool json);

}  // namespace trem
