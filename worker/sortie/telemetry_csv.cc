#include "worker/sortie/telemetry_csv.h"

#include <algorithm>
#include <charconv>
#include <cmath>

#include "mosaic/base/file.h"
#include "mosaic/base/suggest.h"
#include "worker/sortie/csv.h"

namespace trem {
namespace {

enum Column {
  kFrame,
  kTime,
  kGroundElevation,
  kLatitude,
  kLongitude,
  kAltitude,
  kYaw,
  kPitch,
  kRoll,
  kHfov,
  kVfov,
  kCornerFirst,  // ul_lat, ul_lon, ur_lat, ur_lon, lr_lat, lr_lon, ll_lat, ll_lon
  kColumnCount = kCornerFirst + 8,
};

enum class Interval { kClosed, kOpen };

struct ColumnSpec {
  const char* name;
  double low;
  double high;
  Interval interval;
  const char* expected;
};

constexpr const char* kLatitudeRange = "-90..90 degrees";
constexpr const char* kLongitudeRange = "-180..180 degrees";

const std::array<ColumnSpec, kColumnCount>& Columns() {
  static const std::array<ColumnSpec, kColumnCount> columns = {{
      {"frame", 0, 0, Interval::kClosed, "a file name or a frame index"},
      {"time_s", -1e12, 1e12, Interval::kClosed, "seconds"},
      {"ground_elevation_m", -1000, 10000, Interval::kClosed, "-1000..10000 metres"},
      {"latitude_deg", -90, 90, Interval::kClosed, kLatitudeRange},
      {"longitude_deg", -180, 180, Interval::kClosed, kLongitudeRange},
      {"altitude_m", -1000, 100000, Interval::kClosed, "-1000..100000 metres"},
      {"yaw_deg", -360, 360, Interval::kClosed, "-360..360 degrees"},
      {"pitch_deg", -90, 90, Interval::kClosed, "-90..90 degrees (-90: straight down)"},
      {"roll_deg", -360, 360, Interval::kClosed, "-360..360 degrees"},
      {"hfov_deg", 0, 180, Interval::kOpen, "more than 0 and less than 180 degrees"},
      {"vfov_deg", 0, 180, Interval::kOpen, "more than 0 and less than 180 degrees"},
      {"corner_ul_lat_deg", -90, 90, Interval::kClosed, kLatitudeRange},
      {"corner_ul_lon_deg", -180, 180, Interval::kClosed, kLongitudeRange},
      {"corner_ur_lat_deg", -90, 90, Interval::kClosed, kLatitudeRange},
      {"corner_ur_lon_deg", -180, 180, Interval::kClosed, kLongitudeRange},
      {"corner_lr_lat_deg", -90, 90, Interval::kClosed, kLatitudeRange},
      {"corner_lr_lon_deg", -180, 180, Interval::kClosed, kLongitudeRange},
      {"corner_ll_lat_deg", -90, 90, Interval::kClosed, kLatitudeRange},
      {"corner_ll_lon_deg", -180, 180, Interval::kClosed, kLongitudeRange},
  }};
  return columns;
}

constexpr std::size_t kWarningsMax = 20;
constexpr std::size_t kShownMax = 40;

// Bytes of a file as they may stand in a message: printable and short.
std::string Shown(std::string_view text) {
  std::string shown(text.substr(0, kShownMax));
  for (char& c : shown) {
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) c = '?';
  }
  return text.size() > kShownMax ? shown + "..." : shown;
}

class Parser {
 public:
  Parser(std::string_view text, const std::string& file_name) : file_name_(file_name), reader_(text, file_name, kTelemetryColumnsMax) {
    positions_.fill(-1);
  }

  Result<TelemetryTable> Parse() {
    CsvRecord record;
    TREM_ASSIGN_OR_RETURN(const bool has_header, reader_.Next(&record));
    if (!has_header) return InvalidInput(file_name_ + ": is empty; expected a header row such as frame,time_s,latitude_deg,...");
    TREM_RETURN_IF_ERROR(ReadHeader(record));
    header_size_ = record.fields.size();
    while (true) {
      TREM_ASSIGN_OR_RETURN(const bool more, reader_.Next(&record));
      if (!more) break;
      if (table_.rows.size() == kTelemetryRowsMax) {
        return Exhausted(file_name_ + ": has more than " + std::to_string(kTelemetryRowsMax) + " rows; split the sortie");
      }
      TREM_RETURN_IF_ERROR(ReadRow(record));
    }
    if (table_.rows.empty()) return InvalidInput(file_name_ + ": has a header but no rows");
    WarnIfRadians();
    return std::move(table_);
  }

 private:
  bool Has(int column) const { return positions_[static_cast<std::size_t>(column)] >= 0; }

  Status ReadHeader(const CsvRecord& record) {
    for (std::size_t i = 0; i < record.fields.size(); ++i) {
      const std::string& name = record.fields[i];
      const auto& columns = Columns();
      const auto found = std::find_if(columns.begin(), columns.end(), [&name](const ColumnSpec& column) { return name == column.name; });
      if (found == columns.end()) {
        table_.unknown_columns.push_back(Shown(name));
        continue;
      }
      int& position = positions_[static_cast<std::size_t>(found - columns.begin())];
      if (position >= 0) return InvalidInput(file_name_ + ":" + std::to_string(record.line) + ": column " + name + " appears twice");
      position = static_cast<int>(i);
    }
    return CheckColumns(record.line);
  }

  Status CheckColumns(int line) {
    std::vector<int> missing_pose;
    std::vector<int> missing_corners;
    for (int column = kLatitude; column <= kRoll; ++column) {
      if (!Has(column)) missing_pose.push_back(column);
    }
    if (!Has(kHfov) && !Has(kVfov)) missing_pose.push_back(kHfov);
    for (int column = kCornerFirst; column < kColumnCount; ++column) {
      if (!Has(column)) missing_corners.push_back(column);
    }
    table_.has_pose = missing_pose.empty();
    table_.has_corners = missing_corners.empty();
    std::vector<int> missing;
    if (!Has(kFrame)) missing.push_back(kFrame);
    // Say what is missing of the variant that the file comes closer to.
    if (!table_.has_pose && !table_.has_corners) {
      const bool means_corners = missing_corners.size() < 8;
      const std::vector<int>& wanted = means_corners ? missing_corners : missing_pose;
      missing.insert(missing.end(), wanted.begin(), wanted.end());
    }
    if (missing.empty()) return {};
    std::string message = file_name_ + ":" + std::to_string(line) + ": the header lacks ";
    for (std::size_t i = 0; i < missing.size(); ++i) {
      const std::string name = Columns()[static_cast<std::size_t>(missing[i])].name;
      message += (i == 0 ? "" : ", ") + name;
      const std::string nearest = NearestColumn(name, table_.unknown_columns);
      if (!nearest.empty()) message += " (did you mean it by " + nearest + "?)";
    }
    return InvalidInput(message + "; expected frame and either latitude_deg, longitude_deg, altitude_m, yaw_deg, pitch_deg, roll_deg, " +
                        "hfov_deg or the eight columns corner_{ul,ur,lr,ll}_{lat,lon}_deg");
  }

  // The unknown column that is spelt nearest to `name`, in quotes, or nothing.
  static std::string NearestColumn(const std::string& name, const std::vector<std::string>& unknown) {
    const std::string clause = DidYouMean(name, unknown);
    const std::size_t begin = clause.find('\'');
    const std::size_t end = clause.rfind('\'');
    return begin == std::string::npos || end <= begin ? "" : clause.substr(begin, end - begin + 1);
  }

  std::string Where(int column) const {
    return file_name_ + ":" + std::to_string(line_) + ": column " + Columns()[static_cast<std::size_t>(column)].name;
  }

  // The number in `column`; nothing when the cell is empty or the column absent.
  Result<std::optional<double>> Number(const CsvRecord& record, int column) const {
    if (!Has(column)) return std::optional<double>();
    const std::string& text = record.fields[static_cast<std::size_t>(positions_[static_cast<std::size_t>(column)])];
    if (text.empty()) return std::optional<double>();
    const ColumnSpec& spec = Columns()[static_cast<std::size_t>(column)];
    double value = 0.0;
    const char* begin = text.data() + (text[0] == '+' ? 1 : 0);
    const auto parsed = std::from_chars(begin, text.data() + text.size(), value);
    if (parsed.ec != std::errc() || parsed.ptr != text.data() + text.size() || !std::isfinite(value)) {
      return InvalidInput(Where(column) + ": found '" + Shown(text) + "', expected a finite number, " + spec.expected);
    }
    const bool inside =
        spec.interval == Interval::kClosed ? value >= spec.low && value <= spec.high : value > spec.low && value < spec.high;
    if (!inside) return InvalidInput(Where(column) + ": found '" + Shown(text) + "', expected " + spec.expected);
    return std::optional<double>(value);
  }

  Status ReadRow(const CsvRecord& record) {
    line_ = record.line;
    if (record.fields.size() != header_size_) {
      return InvalidInput(file_name_ + ":" + std::to_string(line_) + ": has " + std::to_string(record.fields.size()) + " cells; expected " +
                          std::to_string(header_size_) + " as in the header");
    }
    std::array<std::optional<double>, kColumnCount> values;
    for (int column = kTime; column < kColumnCount; ++column) {
      TREM_ASSIGN_OR_RETURN(values[static_cast<std::size_t>(column)], Number(record, column));
    }
    TelemetryRow row;
    row.line = line_;
    row.frame = record.fields[static_cast<std::size_t>(positions_[kFrame])];
    if (row.frame.empty()) return InvalidInput(Where(kFrame) + ": is empty, expected a file name or a frame index");
    row.time_s = values[kTime];
    row.ground_elevation_m = values[kGroundElevation];
    row.pose = MakePose(values);
    row.corners = MakeCorners(values);
    if (row.pose.has_value() && row.pose->pitch_deg > 0.0) Warn(kPitch, "the camera looks above the horizon");
    table_.rows.push_back(std::move(row));
    return {};
  }

  std::optional<TelemetryPose> MakePose(const std::array<std::optional<double>, kColumnCount>& values) const {
    if (!table_.has_pose || (!values[kHfov].has_value() && !values[kVfov].has_value())) return std::nullopt;
    for (std::size_t column = kLatitude; column <= kRoll; ++column) {
      if (!values[column].has_value()) return std::nullopt;
    }
    return TelemetryPose{*values[kLatitude], *values[kLongitude], *values[kAltitude], *values[kYaw],
                         *values[kPitch],    *values[kRoll],      values[kHfov],      values[kVfov]};
  }

  std::optional<TelemetryCorners> MakeCorners(const std::array<std::optional<double>, kColumnCount>& values) const {
    if (!table_.has_corners) return std::nullopt;
    TelemetryCorners corners{};
    for (std::size_t i = 0; i < 8; ++i) {
      // The columns hold latitude before longitude, the result longitude before latitude.
      const std::optional<double>& value = values[kCornerFirst + (i ^ 1U)];
      if (!value.has_value()) return std::nullopt;
      corners[i] = *value;
    }
    return corners;
  }

  void Warn(int column, const std::string& what) {
    if (table_.warnings.size() < kWarningsMax) table_.warnings.push_back(Where(column) + ": " + what);
  }

  void WarnIfRadians() {
    double pitch_max = 0.0;
    double hfov_max = 0.0;
    for (const TelemetryRow& row : table_.rows) {
      if (!row.pose.has_value()) continue;
      pitch_max = std::max(pitch_max, std::abs(row.pose->pitch_deg));
      hfov_max = std::max(hfov_max, row.pose->hfov_deg.value_or(row.pose->vfov_deg.value_or(0.0)));
    }
    if (pitch_max > 0.0 && pitch_max <= M_PI / 2.0 + 1e-6 && hfov_max <= M_PI) {
      table_.warnings.push_back(file_name_ + ": every pitch_deg lies within 1.58 and every field of view within 3.15; this looks like " +
                                "radians, expected degrees");
    }
  }

  const std::string& file_name_;
  CsvReader reader_;
  TelemetryTable table_;
  std::array<int, kColumnCount> positions_{};
  std::size_t header_size_ = 0;
  int line_ = 0;
};

}  // namespace

Result<TelemetryTable> ParseTelemetryCsv(std::string_view text, const std::string& file_name) {
  if (text.size() > kTelemetryBytesMax) {
    return Exhausted(file_name + ": has " + std::to_string(text.size()) + " bytes; expected at most " + std::to_string(kTelemetryBytesMax));
  }
  return Parser(text, file_name).Parse();
}

Result<TelemetryTable> ReadTelemetryCsv(const std::string& path) {
  TREM_ASSIGN_OR_RETURN(const std::string text, ReadFile(path, kTelemetryBytesMax));
  return ParseTelemetryCsv(text, path);
}

}  // namespace trem
