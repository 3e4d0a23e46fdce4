#include "worker/telemetry/track_files.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <numbers>
#include <pugixml.hpp>

#include "worker/telemetry/text_scan.h"

namespace trem {
namespace {

constexpr double kMetresPerDegree = 111320.0;
constexpr double kCourseStep_m = 2.0;
constexpr std::size_t kShownMax = 40;

std::string Shown(std::string_view text) {
  std::string shown(text.substr(0, kShownMax));
  for (char& c : shown) {
    if (static_cast<unsigned char>(c) < 0x20 || static_cast<unsigned char>(c) >= 0x7f) c = '?';
  }
  return shown;
}

std::optional<GeoPoint> MakePlace(std::optional<double> latitude, std::optional<double> longitude) {
  if (!latitude.has_value() || !longitude.has_value() || std::abs(*latitude) > 90.0 || std::abs(*longitude) > 180.0) return std::nullopt;
  return GeoPoint{*latitude, *longitude};
}

// One line of `text` from `*at` on, without its line break; moves on.
std::string_view NextLine(std::string_view text, std::size_t* at) {
  const std::size_t end = std::min(text.find('\n', *at), text.size());
  std::string_view line = text.substr(*at, end - *at);
  *at = end + 1;
  if (line.ends_with('\r')) line.remove_suffix(1);
  return line;
}

// "00:01:02,345 --> ...": seconds.
std::optional<double> ParseStart(std::string_view line) {
  std::array<double, 4> parts{};
  constexpr std::string_view kSeparators = "::,";
  for (std::size_t i = 0; i < 4; ++i) {
    int value = 0;
    const auto parsed = std::from_chars(line.data(), line.data() + std::min<std::size_t>(line.size(), 6), value);
    if (parsed.ec != std::errc() || value < 0) return std::nullopt;
    parts[i] = value;
    line.remove_prefix(static_cast<std::size_t>(parsed.ptr - line.data()));
    if (i == 3) break;
    if (line.empty() || (line[0] != kSeparators[i] && !(i == 2 && line[0] == '.'))) return std::nullopt;
    line.remove_prefix(1);
  }
  return 3600.0 * parts[0] + 60.0 * parts[1] + parts[2] + 1e-3 * parts[3];
}

// "GPS(longitude,latitude,...)" of older firmware.
std::optional<GeoPoint> OldPlace(std::string_view text) {
  const std::size_t at = text.find("GPS");
  const std::size_t open = at == std::string_view::npos ? at : text.find('(', at);
  if (open == std::string_view::npos || open > at + 5) return std::nullopt;
  const std::size_t first = text.find(',', open);
  const std::size_t second = first == std::string_view::npos ? first : text.find_first_of(",)", first + 1);
  if (second == std::string_view::npos) return std::nullopt;
  return MakePlace(ParseDecimal(text.substr(first + 1, second - first - 1)), ParseDecimal(text.substr(open + 1, first - open - 1)));
}

std::optional<double> FirstOf(std::string_view text, std::initializer_list<std::string_view> keys) {
  for (const std::string_view key : keys) {
    const std::optional<double> value = NumberAfter(text, key);
    if (value.has_value()) return value;
  }
  return std::nullopt;
}

void ReadSubtitle(std::string_view text, double aspect, TelemetryRecord* record) {
  record->sensor = MakePlace(FirstOf(text, {"latitude"}), FirstOf(text, {"longitude", "longtitude"}));
  if (!record->sensor.has_value()) record->sensor = OldPlace(text);
  const std::optional<double> absolute = FirstOf(text, {"abs_alt"});
  const std::optional<double> relative = FirstOf(text, {"rel_alt", "altitude", "BAROMETER"});
  record->altitude_msl_m = absolute.has_value() ? absolute : relative;
  if (relative.has_value()) record->centre_elevation_msl_m = absolute.has_value() ? *absolute - *relative : 0.0;
  record->sensor_azimuth_deg = FirstOf(text, {"gb_yaw"});
  record->sensor_elevation_deg = FirstOf(text, {"gb_pitch"});
  record->sensor_roll_deg = FirstOf(text, {"gb_roll"});
  std::optional<double> focal_mm = FirstOf(text, {"focal_len"});
  // Firmware that writes tenths of a millimetre writes no decimals.
  if (focal_mm.has_value() && *focal_mm >= 100.0 && *focal_mm == std::floor(*focal_mm)) *focal_mm *= 0.1;
  if (focal_mm.has_value() && *focal_mm >= 1.0 && *focal_mm <= 2000.0) record->hfov_deg = HfovOfFocal35(*focal_mm, aspect);
}

// A text's whole length, or why it is too long.
Status CheckSize(std::string_view text, std::size_t most, const std::string& file_name) {
  if (text.size() <= most) return {};
  return Exhausted(file_name + ": has " + std::to_string(text.size()) + " bytes; expected at most " + std::to_string(most));
}

Result<TelemetryRecord> ReadTrackPoint(const pugi::xml_node& point, int number, const std::string& file_name) {
  const std::string where = file_name + ": track point " + std::to_string(number);
  const std::string_view latitude = point.attribute("lat").value();
  const std::string_view longitude = point.attribute("lon").value();
  TelemetryRecord record;
  record.sensor = MakePlace(ParseDecimal(latitude), ParseDecimal(longitude));
  if (!record.sensor.has_value()) {
    return InvalidInput(where + ": found lat '" + Shown(latitude) + "' and lon '" + Shown(longitude) +
                        "', expected degrees in -90..90 and -180..180");
  }
  const std::string_view elevation = point.child_value("ele");
  record.altitude_msl_m = ParseDecimal(elevation);
  if (!elevation.empty() && (!record.altitude_msl_m.has_value() || std::abs(*record.altitude_msl_m) > 100e3)) {
    return InvalidInput(where + ": found ele '" + Shown(elevation) + "', expected metres");
  }
  const std::string_view time = point.child_value("time");
  record.utc_us = ParseTimeUtc(time);
  if (!time.empty() && !record.utc_us.has_value()) {
    return InvalidInput(where + ": found time '" + Shown(time) + "', expected one such as 2024-05-17T10:20:30Z");
  }
  return record;
}

// Metres east and north from a to b.
std::array<double, 2> Between(const GeoPoint& a, const GeoPoint& b) {
  return {std::remainder(b.longitude_deg - a.longitude_deg, 360.0) * kMetresPerDegree * std::cos(a.latitude_deg * std::numbers::pi / 180.0),
          (b.latitude_deg - a.latitude_deg) * kMetresPerDegree};
}

// Bearing of the movement at record i; nothing where the camera stands still throughout.
std::optional<double> CourseAt(const std::vector<TelemetryRecord>& records, std::size_t i) {
  if (!records[i].sensor.has_value()) return std::nullopt;
  const auto far = [&](std::size_t k) {
    if (!records[k].sensor.has_value()) return false;
    const auto way = Between(*records[i].sensor, *records[k].sensor);
    return std::hypot(way[0], way[1]) >= kCourseStep_m;
  };
  std::size_t before = i;
  while (before > 0 && !far(before)) --before;
  std::size_t after = i;
  while (after + 1 < records.size() && !far(after)) ++after;
  const std::size_t from = far(before) ? before : i;
  const std::size_t to = far(after) ? after : i;
  if (from == to) return std::nullopt;
  const auto way = Between(*records[from].sensor, *records[to].sensor);
  return std::atan2(way[0], way[1]) * 180.0 / std::numbers::pi;
}

}  // namespace

Result<std::vector<TelemetryRecord>> ParseDjiSrt(std::string_view text, const std::string& file_name, double aspect) {
  TREM_RETURN_IF_ERROR(CheckSize(text, kSrtBytesMax, file_name));
  std::vector<TelemetryRecord> records;
  std::size_t at = 0;
  int line_number = 0;
  int blocks = 0;
  std::optional<double> start_s;
  std::size_t body = 0;
  const auto close = [&](std::size_t end) {
    if (!start_s.has_value()) return;
    TelemetryRecord record;
    record.time_s = *start_s;
    ReadSubtitle(text.substr(body, end - body), aspect, &record);
    // Blocks without a place, and repeated moments, bring nothing.
    if (record.sensor.has_value() && (records.empty() || record.time_s > records.back().time_s)) records.push_back(record);
    start_s.reset();
  };
  while (at < text.size()) {
    const std::size_t begin = at;
    const std::string_view line = NextLine(text, &at);
    ++line_number;
    if (line.find("-->") == std::string_view::npos) continue;
    close(begin);
    if (++blocks > static_cast<int>(kTrackPointsMax))
      return Exhausted(file_name + ": has more than " + std::to_string(kTrackPointsMax) + " subtitles");
    start_s = ParseStart(line);
    if (!start_s.has_value()) {
      return InvalidInput(file_name + ":" + std::to_string(line_number) + ": found '" + Shown(line) +
                          "', expected hh:mm:ss,mmm --> hh:mm:ss,mmm");
    }
    body = std::min(at, text.size());
  }
  close(text.size());
  if (records.empty()) {
    return InvalidInput(file_name + ": none of its " + std::to_string(blocks) +
                        " subtitles states a place; expected DJI's [latitude: ..] [longitude: ..] " + "or GPS(..)");
  }
  return records;
}

Result<std::vector<TelemetryRecord>> ParseGpx(std::string_view text, const std::string& file_name) {
  TREM_RETURN_IF_ERROR(CheckSize(text, kGpxBytesMax, file_name));
  pugi::xml_document document;
  const pugi::xml_parse_result parsed = document.load_buffer(text.data(), text.size());
  if (!parsed)
    return InvalidInput(file_name + ": byte " + std::to_string(parsed.offset) + ": " + parsed.description() + "; expected a GPX track");
  const pugi::xml_node gpx = document.child("gpx");
  if (gpx.empty()) return InvalidInput(file_name + ": has no gpx element; expected a GPX track");
  std::vector<TelemetryRecord> records;
  int number = 0;
  for (const pugi::xml_node& track : gpx.children("trk")) {
    for (const pugi::xml_node& segment : track.children("trkseg")) {
      for (const pugi::xml_node& point : segment.children("trkpt")) {
        if (number == static_cast<int>(kTrackPointsMax)) {
          return Exhausted(file_name + ": has more than " + std::to_string(kTrackPointsMax) + " track points");
        }
        TREM_ASSIGN_OR_RETURN(const TelemetryRecord record, ReadTrackPoint(point, ++number, file_name));
        if (record.utc_us.has_value()) records.push_back(record);
      }
    }
  }
  std::stable_sort(records.begin(), records.end(),
                   [](const TelemetryRecord& a, const TelemetryRecord& b) { return *a.utc_us < *b.utc_us; });
  records.erase(std::unique(records.begin(), records.end(),
                            [](const TelemetryRecord& a, const TelemetryRecord& b) { return *a.utc_us == *b.utc_us; }),
                records.end());
  if (records.size() < 2) {
    return InvalidInput(file_name + ": " + std::to_string(records.size()) + " of its " + std::to_string(number) +
                        " track points have a time of their own; expected two or more");
  }
  for (TelemetryRecord& record : records) record.time_s = 1e-6 * static_cast<double>(*record.utc_us - *records.front().utc_us);
  return records;
}

void FillPointing(const FixedPointing& fixed, std::vector<TelemetryRecord>* records) {
  std::optional<double> last_course;
  for (std::size_t i = 0; i < records->size(); ++i) {
    TelemetryRecord& record = (*records)[i];
    if (fixed.hfov_deg.has_value()) {
      record.hfov_deg = fixed.hfov_deg;
      record.vfov_deg.reset();
    }
    if (!record.sensor_elevation_deg.has_value()) record.sensor_elevation_deg = fixed.pitch_deg;
    if (!record.sensor_roll_deg.has_value()) record.sensor_roll_deg = fixed.roll_deg;
    if (record.sensor_azimuth_deg.has_value() || !record.sensor_elevation_deg.has_value()) continue;
    record.sensor_azimuth_deg = fixed.yaw_deg;
    if (record.sensor_azimuth_deg.has_value()) continue;
    const std::optional<double> course = CourseAt(*records, i);
    if (course.has_value()) last_course = course;
    record.sensor_azimuth_deg = last_course;
  }
}

}  // namespace trem
