#include "worker/sortie/control_csv.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <map>
#include <optional>
#include <sstream>

#include "mosaic/base/file.h"
#include "mosaic/base/suggest.h"
#include "worker/sortie/csv.h"

namespace trem {
namespace {

constexpr std::size_t kColumnsMax = 64;
constexpr std::size_t kShownMax = 40;

struct ColumnSpec {
  const char* name;
  double low;
  double high;
  const char* expected;
};

enum Column { kName, kFrame, kLongitude, kLatitude, kElevation, kX, kY, kColumnCount };

constexpr std::array<ColumnSpec, kColumnCount> kColumns = {{
    {"name", 0, 0, "the point's name"},
    {"frame", 0, 0, "a file name or a frame index"},
    {"longitude_deg", -180, 180, "-180..180 degrees"},
    {"latitude_deg", -90, 90, "-90..90 degrees"},
    {"elevation_m", -1000, 10000, "-1000..10000 metres"},
    {"x_px", -1e6, 1e6, "sensor pixels"},
    {"y_px", -1e6, 1e6, "sensor pixels"},
}};

using Positions = std::array<int, kColumnCount>;

std::string Shown(const std::string& text) {
  std::string shown = text.substr(0, kShownMax);
  for (char& c : shown) {
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) c = '?';
  }
  return shown;
}

Result<Positions> ReadHeader(const CsvRecord& record, const std::string& file_name) {
  Positions positions;
  positions.fill(-1);
  for (std::size_t i = 0; i < record.fields.size(); ++i) {
    for (std::size_t column = 0; column < kColumnCount; ++column) {
      if (record.fields[i] != kColumns[column].name) continue;
      if (positions[column] >= 0) {
        return InvalidInput(file_name + ":" + std::to_string(record.line) + ": column " + kColumns[column].name + " appears twice");
      }
      positions[column] = static_cast<int>(i);
    }
  }
  for (std::size_t column = 0; column < kColumnCount; ++column) {
    if (positions[column] >= 0) continue;
    return InvalidInput(file_name + ":" + std::to_string(record.line) + ": the header lacks " + kColumns[column].name +
                        "; expected name, longitude_deg, latitude_deg, elevation_m, frame, x_px and y_px");
  }
  return positions;
}

Result<ControlRow> ReadRow(const CsvRecord& record, const Positions& positions, std::size_t width, const std::string& file_name) {
  const std::string where = file_name + ":" + std::to_string(record.line) + ": ";
  if (record.fields.size() != width) {
    return InvalidInput(where + "has " + std::to_string(record.fields.size()) + " cells; expected " + std::to_string(width) +
                        " as in the header");
  }
  std::array<double, kColumnCount> values{};
  for (std::size_t column = 0; column < kColumnCount; ++column) {
    const std::string& text = record.fields[static_cast<std::size_t>(positions[column])];
    const ColumnSpec& spec = kColumns[column];
    bool good = !text.empty();
    if (good && column > kFrame) {
      const char* const begin = text.data() + (text[0] == '+' ? 1 : 0);
      const auto parsed = std::from_chars(begin, text.data() + text.size(), values[column]);
      good = parsed.ec == std::errc() && parsed.ptr == text.data() + text.size() && values[column] >= spec.low && values[column] <= spec.high;
    }
    if (!good) return InvalidInput(where + "column " + spec.name + ": found '" + Shown(text) + "', expected " + spec.expected);
  }
  return ControlRow{record.line,
                    record.fields[static_cast<std::size_t>(positions[kName])],
                    values[kLongitude],
                    values[kLatitude],
                    values[kElevation],
                    record.fields[static_cast<std::size_t>(positions[kFrame])],
                    values[kX],
                    values[kY]};
}

// Frames by file name, by name without extension and by index, in that order of precedence.
class FrameFinder {
 public:
  explicit FrameFinder(const v1::SortieManifest& manifest) : frame_count_(manifest.frames_size()) {
    for (int t = 0; t < manifest.frames_size(); ++t) by_name_.emplace(manifest.frames(t).name(), t);
    for (int t = 0; t < manifest.frames_size(); ++t) by_name_.emplace(std::filesystem::path(manifest.frames(t).name()).stem().string(), t);
  }
  std::optional<int> Find(const std::string& text) const {
    const auto found = by_name_.find(text);
    if (found != by_name_.end()) return found->second;
    int index = -1;
    const auto parsed = std::from_chars(text.data(), text.data() + text.size(), index);
    if (parsed.ec != std::errc() || parsed.ptr != text.data() + text.size() || index < 0 || index >= frame_count_) return std::nullopt;
    return index;
  }

 private:
  int frame_count_;
  std::map<std::string, int> by_name_;
};

Status CheckHeldOut(const v1::Control& spec, const std::vector<ControlRow>& rows) {
  std::vector<std::string> names;
  for (const ControlRow& row : rows) names.push_back(row.name);
  for (const std::string& name : HeldOutNames(spec)) {
    if (name == "*" || std::find(names.begin(), names.end(), name) != names.end()) continue;
    return InvalidInput("control.held_out names '" + Shown(name) + "', which " + spec.path() + " does not have" + DidYouMean(name, names));
  }
  return {};
}

void AddNote(const std::string& message, v1::SortieManifest* manifest) {
  v1::Note* const note = manifest->add_notes();
  note->set_code("control_frames_unknown");
  note->set_message(message);
  note->set_severity(v1::WARNING);
}

}  // namespace

Result<std::vector<ControlRow>> ParseControlCsv(std::string_view text, const std::string& file_name) {
  if (text.size() > kControlBytesMax) {
    return Exhausted(file_name + ": has " + std::to_string(text.size()) + " bytes; expected at most " + std::to_string(kControlBytesMax));
  }
  CsvReader reader(text, file_name, kColumnsMax);
  CsvRecord record;
  TREM_ASSIGN_OR_RETURN(const bool has_header, reader.Next(&record));
  if (!has_header) return InvalidInput(file_name + ": is empty; expected a header row such as name,longitude_deg,latitude_deg,...");
  TREM_ASSIGN_OR_RETURN(const Positions positions, ReadHeader(record, file_name));
  const std::size_t width = record.fields.size();
  std::vector<ControlRow> rows;
  while (true) {
    TREM_ASSIGN_OR_RETURN(const bool more, reader.Next(&record));
    if (!more) break;
    if (rows.size() == kControlRowsMax) return Exhausted(file_name + ": has more than " + std::to_string(kControlRowsMax) + " rows");
    TREM_ASSIGN_OR_RETURN(ControlRow row, ReadRow(record, positions, width, file_name));
    rows.push_back(std::move(row));
  }
  if (rows.empty()) return InvalidInput(file_name + ": has a header but no rows");
  return rows;
}

std::vector<std::string> HeldOutNames(const v1::Control& spec) {
  std::vector<std::string> names;
  std::istringstream list(spec.held_out());
  for (std::string name; std::getline(list, name, ',');) {
    const std::size_t first = name.find_first_not_of(' ');
    if (first != std::string::npos) names.push_back(name.substr(first, name.find_last_not_of(' ') - first + 1));
  }
  return names;
}

Status AttachControl(const v1::Control& spec, v1::SortieManifest* manifest) {
  if (spec.path().empty()) return {};
  TREM_ASSIGN_OR_RETURN(const std::string text, ReadFile(spec.path(), kControlBytesMax));
  TREM_ASSIGN_OR_RETURN(const std::vector<ControlRow> rows, ParseControlCsv(text, spec.path()));
  TREM_RETURN_IF_ERROR(CheckHeldOut(spec, rows));
  const FrameFinder frames(*manifest);
  std::string unknown;
  int unknown_count = 0;
  for (const ControlRow& row : rows) {
    const std::optional<int> frame = frames.Find(row.frame);
    if (!frame) {
      if (++unknown_count <= 5) unknown += (unknown_count == 1 ? "" : ", ") + Shown(row.frame) + " (line " + std::to_string(row.line) + ")";
      continue;
    }
    if (!(row.x_px >= -0.5 && row.x_px <= manifest->width_px() - 0.5 && row.y_px >= -0.5 && row.y_px <= manifest->height_px() - 0.5)) {
      return InvalidInput(spec.path() + ":" + std::to_string(row.line) + ": x_px, y_px: found " + std::to_string(row.x_px) + ", " +
                          std::to_string(row.y_px) + ", expected a place in the image of " + std::to_string(manifest->width_px()) + " x " +
                          std::to_string(manifest->height_px()) + " pixels, whose upper left one has its centre at 0, 0");
    }
    v1::ControlObservation* const out = manifest->add_control();
    out->set_name(row.name);
    out->set_longitude_deg(row.longitude_deg);
    out->set_latitude_deg(row.latitude_deg);
    out->set_elevation_m(row.elevation_m);
    out->set_frame_index(static_cast<std::uint32_t>(*frame));
    out->set_x_px(row.x_px);
    out->set_y_px(row.y_px);
  }
  if (manifest->control_size() == 0) {
    return InvalidInput(spec.path() + ": no row names a frame of the sortie; found " + unknown + ", expected file names such as " +
                        manifest->frames(0).name() + " or frame indices below " + std::to_string(manifest->frames_size()));
  }
  if (unknown_count > 0) {
    AddNote(spec.path() + ": " + std::to_string(unknown_count) + " rows are of frames that the sortie does not have: " + unknown, manifest);
  }
  return {};
}

}  // namespace trem
