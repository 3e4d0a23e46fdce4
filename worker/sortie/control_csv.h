#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "mosaic/base/status.h"
#include "proto/trem/v1/job.pb.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// Limits of a gcp.csv.
inline constexpr std::size_t kControlBytesMax = std::size_t{16} << 20;
inline constexpr std::size_t kControlRowsMax = 10'000;

// One observation of a ground control point (WGS 84 degrees; metres in the telemetry's vertical datum; sensor pixels).
struct ControlRow {
  int line = 0;
  std::string name;
  double longitude_deg = 0.0;
  double latitude_deg = 0.0;
  double elevation_m = 0.0;
  std::string frame;  // File name, with or without extension, or frame index.
  double x_px = 0.0;
  double y_px = 0.0;
};

// Parses a gcp.csv: RFC 4180, a header row with name, longitude_deg, latitude_deg, elevation_m, frame, x_px and y_px in any order; other
// columns are ignored. kInvalidInput: "<file_name>:<line>: column <name>: found '<text>', expected ...".
Result<std::vector<ControlRow>> ParseControlCsv(std::string_view text, const std::string& file_name);

// The names in control.held_out, without blanks around them.
std::vector<std::string> HeldOutNames(const v1::Control& spec);

// Reads control.path of the spec, when set, into manifest.control. Rows of frames that the manifest does not have are noted.
// kInvalidInput when no row's frame is there, a pixel lies outside of the image, or control.held_out names a point that the file does not
// have.
Status AttachControl(const v1::Control& spec, v1::SortieManifest* manifest);

}  // namespace trem
