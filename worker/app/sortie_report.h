#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "proto/trem/v1/task.pb.h"

namespace trem {

// What a person wants to know about a sortie, derived from its manifest.
struct SortieReport {
  // Ground that the frames with telemetry show, WGS 84 degrees.
  struct Footprint {
    double west_deg = 0.0;
    double south_deg = 0.0;
    double east_deg = 0.0;
    double north_deg = 0.0;
    double gsd_m = 0.0;            // Median ground sample distance at the image centre.
    int frame_count = 0;           // Frames it is made of.
    int beyond_horizon_count = 0;  // Frames that see no ground in some corner: left out.
  };

  int frame_count = 0;
  int usable_count = 0;
  int unreadable_count = 0;
  int wrong_size_count = 0;
  int blank_count = 0;
  int repeated_count = 0;
  double duration_s = 0.0;
  double frame_rate_hz = 0.0;  // Of the median interval; 0: one frame.
  int posed_count = 0;
  int cornered_count = 0;
  int link_count = 0;            // Pairs of successive usable frames.
  int failed_link_count = 0;     // Of them, those that could not be registered.
  double correlation_low = 0.0;  // 5 % quantile over the links found.
  double motion_median_px = 0.0;
  double motion_max_px = 0.0;
  std::optional<Footprint> footprint;
};

SortieReport ReportOn(const v1::SortieManifest& manifest);

// For people: several lines that end in a line break.
std::string FormatReport(const v1::SortieManifest& manifest, const SortieReport& report);
// For programs: one JSON object, indented.
std::string FormatReportAsJson(const v1::SortieManifest& manifest, const SortieReport& report);

// The same of a sortie's recordings, in order: of one as above; of several one after the other, as JSON in "recordings". Parallel, not
// empty.
std::string FormatReports(const std::vector<v1::SortieManifest>& manifests, const std::vector<SortieReport>& reports);
std::string FormatReportsAsJson(const std::vector<v1::SortieManifest>& manifests, const std::vector<SortieReport>& reports);

}  // namespace trem
