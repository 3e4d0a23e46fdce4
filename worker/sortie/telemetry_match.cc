#include "worker/sortie/telemetry_match.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <map>
#include <vector>

#include "worker/sortie/frame_source.h"
#include "worker/sortie/image_sequence_reader.h"
#include "worker/telemetry/utc_clock.h"

namespace trem {
namespace {

constexpr double kInterpolationGap_s = 5.0;
constexpr double kSpeedMax_m_s = 400.0;
constexpr double kMetresPerDegree = 111320.0;
constexpr double kGroundSpread_m = 50.0;

// The frame number that a telemetry cell or a video frame's name ("#12") states.
std::optional<std::int64_t> ParseNumber(std::string_view text) {
  if (text.starts_with('#')) text.remove_prefix(1);
  std::int64_t number = 0;
  const auto parsed = std::from_chars(text.data(), text.data() + text.size(), number);
  if (text.empty() || parsed.ec != std::errc() || parsed.ptr != text.data() + text.size()) return std::nullopt;
  return number;
}

// Manifest frame by anything that a row may call it.
std::map<std::string, int, std::less<>> FramesByFileName(const v1::SortieManifest& manifest) {
  std::map<std::string, int, std::less<>> frames;
  for (int i = 0; i < manifest.frames_size(); ++i) {
    const std::filesystem::path name = manifest.frames(i).name();
    for (const std::string& key : {name.string(), name.filename().string(), name.stem().string()}) frames.emplace(key, i);
  }
  return frames;
}

class Matcher {
 public:
  Matcher(const TelemetryTable& table, const std::string& path, v1::SortieManifest* manifest)
      : table_(table), path_(path), manifest_(*manifest), row_of_frame_(static_cast<std::size_t>(manifest->frames_size()), nullptr) {}

  Status Match() {
    int matched = 0;
    if (manifest_.source_kind() == v1::IMAGE_SEQUENCE) matched = MatchByName();
    if (matched == 0) matched = MatchByNumber();
    if (matched == 0) {
      return InvalidInput(path_ + ": no row matches any frame; its first row is about '" + table_.rows.front().frame +
                          "', the sortie's first frame is '" + manifest_.frames(0).name() +
                          "'; expected file names or frame indices in column frame (or set telemetry.ignore)");
    }
    const auto rows = static_cast<int>(table_.rows.size());
    if (rows > matched + repeated_) {
      Note(v1::INFO, "telemetry_rows_unused",
           std::to_string(rows - matched - repeated_) + " of " + std::to_string(rows) + " rows belong to no frame of the sortie");
    }
    if (repeated_ > 0) {
      Note(v1::WARNING, "telemetry_rows_repeated",
           std::to_string(repeated_) + " rows repeat a frame, first in line " + std::to_string(first_repeated_line_) +
               "; the first row of each frame was used");
    }
    if (matched < manifest_.frames_size()) {
      Note(v1::INFO, "frames_without_row",
           std::to_string(manifest_.frames_size() - matched) + " of " + std::to_string(manifest_.frames_size()) +
               " frames have no row of their own");
    }
    return {};
  }

  void SetTimes() {
    if (manifest_.source_kind() != v1::IMAGE_SEQUENCE) return;
    std::vector<int> known;
    for (int i = 0; i < manifest_.frames_size(); ++i) {
      if (Row(i) != nullptr && Row(i)->time_s.has_value()) known.push_back(i);
    }
    if (known.empty()) return;
    // Frames without a time: between two known ones in proportion, outside at the mean interval (or the frame rate).
    const auto time = [&](int i) { return *Row(i)->time_s; };
    double interval_s = manifest_.frames_size() > 1 ? manifest_.frames(1).time_s() - manifest_.frames(0).time_s() : 0.0;
    if (known.size() > 1) interval_s = (time(known.back()) - time(known.front())) / (known.back() - known.front());
    std::size_t next = 0;
    for (int i = 0; i < manifest_.frames_size(); ++i) {
      while (next < known.size() && known[next] < i) ++next;
      double value = 0.0;
      if (next < known.size() && known[next] == i) {
        value = time(i);
      } else if (next == 0) {
        value = time(known[0]) - interval_s * (known[0] - i);
      } else if (next == known.size()) {
        value = time(known.back()) + interval_s * (i - known.back());
      } else {
        const int a = known[next - 1];
        const int b = known[next];
        value = time(a) + (time(b) - time(a)) * (i - a) / (b - a);
      }
      manifest_.mutable_frames(i)->set_time_s(value);
    }
    NoteBackwardTimes();
  }

  // Times of rows that count from 1970, and of images that tell themselves when they were taken.
  void SetUtc() {
    for (int i = 0; i < manifest_.frames_size(); ++i) {
      v1::ManifestFrame* frame = manifest_.mutable_frames(i);
      const TelemetryRow* row = Row(i);
      std::optional<double> time_s = row != nullptr ? row->time_s : std::nullopt;
      // Those of images are interpolated.
      if (manifest_.source_kind() == v1::IMAGE_SEQUENCE) time_s = frame->time_s();
      const std::optional<std::int64_t> utc_us = row != nullptr && row->utc_us.has_value() ? row->utc_us : UtcOf(time_s);
      if (utc_us.has_value()) frame->set_utc_us(*utc_us);
    }
  }

  void SetPoses() {
    int interpolated = 0;
    int last_pose = -1;
    int last_corners = -1;
    for (int i = 0; i < manifest_.frames_size(); ++i) {
      const TelemetryRow* row = Row(i);
      if (row == nullptr) continue;
      v1::ManifestFrame* frame = manifest_.mutable_frames(i);
      if (row->pose.has_value()) {
        *frame->mutable_pose() = ToPose(*row->pose);
        interpolated += Interpolate(last_pose, i, &Matcher::InterpolatePose);
        last_pose = i;
      }
      if (row->corners.has_value()) {
        for (const double number : *row->corners) frame->add_corner_lon_lat_deg(number);
        const int between = Interpolate(last_corners, i, &Matcher::InterpolateCorners);
        if (!table_.has_pose) interpolated += between;
        last_corners = i;
      }
    }
    if (interpolated > 0) {
      Note(v1::INFO, "poses_interpolated", std::to_string(interpolated) + " frames got poses interpolated between their neighbours'");
    }
    NoteSuspiciousPoses();
  }

  void SetGroundElevation(const v1::Telemetry& spec) {
    std::vector<double> elevations;
    for (const TelemetryRow* row : row_of_frame_) {
      if (row != nullptr && row->ground_elevation_m.has_value()) elevations.push_back(*row->ground_elevation_m);
    }
    std::sort(elevations.begin(), elevations.end());
    double elevation_m = 0.0;
    if (spec.has_ground_elevation_m()) {
      elevation_m = spec.ground_elevation_m();
    } else if (!elevations.empty()) {
      elevation_m = elevations[elevations.size() / 2];
      if (elevations.back() - elevations.front() > kGroundSpread_m) {
        Note(v1::WARNING, "ground_not_level",
             "ground_elevation_m varies by " + std::to_string(elevations.back() - elevations.front()) + " m; its median, " +
                 std::to_string(elevation_m) + " m, is used for all frames");
      }
    } else {
      Note(v1::INFO, "ground_elevation_assumed",
           "no ground_elevation_m column and telemetry.ground_elevation_m is not set: 0 m is assumed in the telemetry's vertical datum");
    }
    manifest_.set_ground_elevation_m(elevation_m);
    int below = 0;
    for (const v1::ManifestFrame& frame : manifest_.frames()) below += frame.has_pose() && frame.pose().altitude_m() <= elevation_m ? 1 : 0;
    if (below > 0) {
      Note(v1::WARNING, "camera_below_ground",
           std::to_string(below) + " frames have a camera altitude at or below the ground's " + std::to_string(elevation_m) +
               " m; check altitude_m and ground_elevation_m");
    }
  }

 private:
  using Between = void (Matcher::*)(int a, int b, int i, double t);

  static std::optional<std::int64_t> UtcOf(std::optional<double> unix_s) {
    if (!unix_s.has_value() || !(1e6 * std::abs(*unix_s) <= static_cast<double>(kUtcMost_us))) return std::nullopt;
    return PlausibleUtc(std::llround(1e6 * *unix_s));
  }

  const TelemetryRow* Row(int i) const { return row_of_frame_[static_cast<std::size_t>(i)]; }
  void Note(v1::Severity severity, const std::string& code, const std::string& message) {
    *manifest_.add_notes() = MakeNote(severity, code, path_, message);
  }

  bool Assign(int frame, const TelemetryRow& row) {
    const TelemetryRow*& slot = row_of_frame_[static_cast<std::size_t>(frame)];
    if (slot == nullptr) {
      slot = &row;
      return true;
    }
    if (repeated_++ == 0) first_repeated_line_ = row.line;
    return false;
  }

  int MatchByName() {
    const auto frames = FramesByFileName(manifest_);
    int matched = 0;
    for (const TelemetryRow& row : table_.rows) {
      auto found = frames.find(row.frame);
      if (found == frames.end()) found = frames.find(std::filesystem::path(row.frame).filename().string());
      if (found != frames.end() && Assign(found->second, row)) ++matched;
    }
    return matched;
  }

  int MatchByNumber() {
    std::map<std::int64_t, int> frames;
    for (int i = 0; i < manifest_.frames_size(); ++i) {
      const std::optional<std::int64_t> number = ParseNumber(manifest_.frames(i).name());
      frames.emplace(manifest_.source_kind() == v1::VIDEO && number.has_value() ? *number : i, i);
    }
    int matched = 0;
    for (const TelemetryRow& row : table_.rows) {
      const std::optional<std::int64_t> number = ParseNumber(row.frame);
      if (!number.has_value()) continue;
      const auto found = frames.find(*number);
      if (found != frames.end() && Assign(found->second, row)) ++matched;
    }
    return matched;
  }

  v1::Pose ToPose(const TelemetryPose& row) const {
    v1::Pose pose;
    pose.set_latitude_deg(row.latitude_deg);
    pose.set_longitude_deg(row.longitude_deg);
    pose.set_altitude_m(row.altitude_m);
    pose.set_yaw_deg(row.yaw_deg);
    pose.set_pitch_deg(row.pitch_deg);
    pose.set_roll_deg(row.roll_deg);
    if (row.hfov_deg.has_value()) {
      pose.set_hfov_deg(*row.hfov_deg);
    } else {
      const double aspect = static_cast<double>(manifest_.width_px()) / manifest_.height_px();
      const double half_vfov_rad = 0.5 * *row.vfov_deg * M_PI / 180.0;
      pose.set_hfov_deg(2.0 * std::atan(aspect * std::tan(half_vfov_rad)) * 180.0 / M_PI);
    }
    return pose;
  }

  // Fills the frames between a and b; returns how many.
  int Interpolate(int a, int b, Between between) {
    if (a < 0 || b - a < 2) return 0;
    const double start_s = manifest_.frames(a).time_s();
    const double span_s = manifest_.frames(b).time_s() - start_s;
    if (!(span_s > 0.0) || span_s > kInterpolationGap_s) return 0;
    int count = 0;
    for (int i = a + 1; i < b; ++i) {
      const double t = (manifest_.frames(i).time_s() - start_s) / span_s;
      if (!(t > 0.0 && t < 1.0)) continue;
      (this->*between)(a, b, i, t);
      ++count;
    }
    return count;
  }

  static double Blend(double a, double b, double t) { return a + (b - a) * t; }
  // Along the shorter arc.
  static double BlendAngle(double a_deg, double b_deg, double t) { return a_deg + std::remainder(b_deg - a_deg, 360.0) * t; }

  void InterpolatePose(int a, int b, int i, double t) {
    const v1::Pose& p = manifest_.frames(a).pose();
    const v1::Pose& q = manifest_.frames(b).pose();
    v1::Pose* pose = manifest_.mutable_frames(i)->mutable_pose();
    pose->set_latitude_deg(Blend(p.latitude_deg(), q.latitude_deg(), t));
    pose->set_longitude_deg(std::remainder(BlendAngle(p.longitude_deg(), q.longitude_deg(), t), 360.0));
    pose->set_altitude_m(Blend(p.altitude_m(), q.altitude_m(), t));
    pose->set_yaw_deg(BlendAngle(p.yaw_deg(), q.yaw_deg(), t));
    pose->set_pitch_deg(Blend(p.pitch_deg(), q.pitch_deg(), t));
    pose->set_roll_deg(BlendAngle(p.roll_deg(), q.roll_deg(), t));
    pose->set_hfov_deg(Blend(p.hfov_deg(), q.hfov_deg(), t));
  }

  void InterpolateCorners(int a, int b, int i, double t) {
    v1::ManifestFrame* frame = manifest_.mutable_frames(i);
    for (int k = 0; k < 8; ++k) {
      const double p = manifest_.frames(a).corner_lon_lat_deg(k);
      const double q = manifest_.frames(b).corner_lon_lat_deg(k);
      frame->add_corner_lon_lat_deg(k % 2 == 0 ? std::remainder(BlendAngle(p, q, t), 360.0) : Blend(p, q, t));
    }
  }

  void NoteBackwardTimes() {
    int backward = 0;
    int first = -1;
    for (int i = 1; i < manifest_.frames_size(); ++i) {
      if (manifest_.frames(i).time_s() > manifest_.frames(i - 1).time_s()) continue;
      if (backward++ == 0) first = i;
    }
    if (backward > 0) {
      Note(v1::WARNING, "times_not_increasing",
           "time_s does not increase at " + std::to_string(backward) + " frames, first at " + manifest_.frames(first).name() +
               "; frames keep the order of their names");
    }
  }

  void NoteSuspiciousPoses() {
    int jumps = 0;
    int first = -1;
    int last = -1;
    for (int i = 0; i < manifest_.frames_size(); ++i) {
      if (!manifest_.frames(i).has_pose()) continue;
      if (last >= 0 && IsJump(manifest_.frames(last), manifest_.frames(i)) && jumps++ == 0) first = i;
      last = i;
    }
    if (jumps > 0) {
      Note(v1::WARNING, "position_jumps",
           "the camera's position jumps at " + std::to_string(jumps) + " frames (more than " +
               std::to_string(static_cast<int>(kSpeedMax_m_s)) + " m/s), first at " + manifest_.frames(first).name());
    }
  }

  static bool IsJump(const v1::ManifestFrame& a, const v1::ManifestFrame& b) {
    const double north_m = (b.pose().latitude_deg() - a.pose().latitude_deg()) * kMetresPerDegree;
    const double east_m = std::remainder(b.pose().longitude_deg() - a.pose().longitude_deg(), 360.0) * kMetresPerDegree *
                          std::cos(a.pose().latitude_deg() * M_PI / 180.0);
    const double up_m = b.pose().altitude_m() - a.pose().altitude_m();
    // 20 m are within what receivers jump by when their satellites change.
    return std::hypot(north_m, east_m, up_m) > 20.0 + kSpeedMax_m_s * std::abs(b.time_s() - a.time_s());
  }

  const TelemetryTable& table_;
  const std::string& path_;
  v1::SortieManifest& manifest_;
  std::vector<const TelemetryRow*> row_of_frame_;
  int repeated_ = 0;
  int first_repeated_line_ = 0;
};

}  // namespace

std::optional<std::string> FindTelemetryCsv(const v1::Sortie& sortie) {
  if (sortie.telemetry().ignore()) return std::nullopt;
  if (!sortie.telemetry().path().empty()) return sortie.telemetry().path();
  std::error_code error;
  const std::filesystem::path source = sortie.source().path();
  const bool is_file = std::filesystem::is_regular_file(source, error);
  const std::filesystem::path folder = std::filesystem::absolute(ImageFolder(source.string()), error).lexically_normal();
  std::vector<std::filesystem::path> candidates = {folder / "telemetry.csv"};
  if (!is_file) {
    // "folder/" has an empty last part.
    const std::filesystem::path own = folder.has_filename() ? folder : folder.parent_path();
    candidates.push_back(own.parent_path() / "telemetry.csv");
  }
  for (const std::filesystem::path& candidate : candidates) {
    if (std::filesystem::is_regular_file(candidate, error)) return candidate.string();
  }
  return std::nullopt;
}

Status AttachTelemetry(const TelemetryTable& table, const std::string& path, const v1::Telemetry& spec, v1::SortieManifest* manifest) {
  TREM_CHECK(!table.rows.empty() && manifest->frames_size() > 0);
  for (const std::string& column : table.unknown_columns) {
    *manifest->add_notes() = MakeNote(v1::INFO, "telemetry_column_ignored", path, "column '" + column + "' is not known and was ignored");
  }
  for (const std::string& warning : table.warnings) {
    *manifest->add_notes() = MakeNote(v1::WARNING, "telemetry_suspicious", path, warning);
  }
  Matcher matcher(table, path, manifest);
  TREM_RETURN_IF_ERROR(matcher.Match());
  matcher.SetTimes();
  matcher.SetUtc();
  matcher.SetPoses();
  matcher.SetGroundElevation(spec);
  manifest->set_telemetry_source(v1::TELEMETRY_CSV);
  manifest->set_telemetry_path(path);
  return {};
}

}  // namespace trem
