#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "mosaic/base/status.h"

namespace trem {

// Limits of a telemetry.csv.
inline constexpr std::size_t kTelemetryBytesMax = std::size_t{64} << 20;
inline constexpr std::size_t kTelemetryRowsMax = 1'000'000;
inline constexpr std::size_t kTelemetryColumnsMax = 64;

// A camera pose as telemetry.csv states it (conventions: docs/USER_GUIDE.md; degrees, metres, WGS 84).
struct TelemetryPose {
  double latitude_deg = 0.0;
  double longitude_deg = 0.0;
  double altitude_m = 0.0;
  double yaw_deg = 0.0;
  double pitch_deg = 0.0;
  double roll_deg = 0.0;
  std::optional<double> hfov_deg;  // At least one of the two is present.
  std::optional<double> vfov_deg;
};

// Outer image corners UL, UR, LR, LL as longitude, latitude [deg].
using TelemetryCorners = std::array<double, 8>;

struct TelemetryRow {
  int line = 0;       // Of the file, counted from 1.
  std::string frame;  // File name or frame index.
  std::optional<double> time_s;
  std::optional<std::int64_t> utc_us;  // Of an image that says when it was taken, whatever time_s counts from.
  std::optional<TelemetryPose> pose;   // Absent when a cell of it is empty.
  std::optional<TelemetryCorners> corners;
  std::optional<double> ground_elevation_m;
};

struct TelemetryTable {
  bool has_pose = false;  // Columns, whether or not every row fills them.
  bool has_corners = false;
  std::vector<TelemetryRow> rows;            // In the file's order.
  std::vector<std::string> unknown_columns;  // Not in telemetry.csv's vocabulary: ignored.
  std::vector<std::string> warnings;         // Suspicious but legal values, each with its line.
};

// Parses a telemetry.csv: RFC 4180 (quotes, CRLF; a byte order mark is skipped), header row, any column order. Needs `frame` and either
// all pose columns (latitude_deg, longitude_deg, altitude_m, yaw_deg, pitch_deg, roll_deg and hfov_deg or vfov_deg) or all eight
// corner_{ul,ur,lr,ll}_{lat,lon}_deg. kInvalidInput: "<file_name>:<line>: column <name>: found '<text>', expected ...".
Result<TelemetryTable> ParseTelemetryCsv(std::string_view text, const std::string& file_name);

// Reads and parses a file.
Result<TelemetryTable> ReadTelemetryCsv(const std::string& path);

}  // namespace trem
