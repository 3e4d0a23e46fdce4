#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "mosaic/base/status.h"
#include "worker/telemetry/telemetry_record.h"

namespace trem {

inline constexpr std::size_t kSrtBytesMax = std::size_t{64} << 20;
inline constexpr std::size_t kGpxBytesMax = std::size_t{16} << 20;
inline constexpr std::size_t kTrackPointsMax = 1'000'000;

// DJI's subtitle tracks: SubRip blocks with "[latitude: ..] [longitude: ..] [rel_alt: .. abs_alt: ..] [gb_yaw: .. gb_pitch: .. gb_roll: ..]
// [focal_len: ..]" (longtitude as older firmware spells it) or "GPS(longitude,latitude,..) .. BAROMETER:height". time_s: the subtitle's
// start. Gimbal angles are absolute. Heights above take-off become altitudes over a ground at 0 where no absolute height is given, and the
// ground's elevation where one is. `aspect`: width over height of the image, for the field of view of a focal length.
// kInvalidInput: "<file_name>:<line>: ..." for a malformed time line, or no block with a place.
Result<std::vector<TelemetryRecord>> ParseDjiSrt(std::string_view text, const std::string& file_name, double aspect);

// A GPX 1.0 or 1.1 track: its points with a time, in the order of time; utc_us is set and time_s counts from the first point. Points'
// places and elevations only: attitude and field of view have to come from elsewhere. kInvalidInput names the file and what is wrong: no
// XML, no gpx element, a point without or with an impossible lat or lon, fewer than two points with a time.
Result<std::vector<TelemetryRecord>> ParseGpx(std::string_view text, const std::string& file_name);

// What the user knows about a camera that its telemetry does not tell; angles as in telemetry.csv.
struct FixedPointing {
  std::optional<double> hfov_deg;
  std::optional<double> yaw_deg;  // Absent: the course over ground.
  std::optional<double> pitch_deg;
  std::optional<double> roll_deg;
};

// Fills in the angles that `records` (in the order of time) do not have, and replaces their fields of view. The course at a record is from
// the last place at least 2 m before to the next at least 2 m after it. Azimuths only where an elevation angle is known.
void FillPointing(const FixedPointing& fixed, std::vector<TelemetryRecord>* records);

}  // namespace trem
