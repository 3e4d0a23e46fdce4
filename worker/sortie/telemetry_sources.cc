#include "worker/sortie/telemetry_sources.h"

#include <algorithm>
#include <cctype>
#include <filesystem>

#include "mosaic/base/file.h"
#include "worker/sortie/frame_source.h"
#include "worker/sortie/image_sequence_reader.h"
#include "worker/sortie/klv_telemetry.h"
#include "worker/sortie/photo_telemetry.h"
#include "worker/sortie/sortie_ground.h"
#include "worker/sortie/telemetry_match.h"
#include "worker/telemetry/track_files.h"

namespace trem {
namespace {

bool IsVideo(const v1::Sortie& sortie) {
  std::error_code error;
  const std::string& path = sortie.source().path();
  return std::filesystem::is_regular_file(path, error) && !HasImageExtension(path);
}

std::string LowerExtension(const std::filesystem::path& path) {
  std::string extension = path.extension().string();
  for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return extension;
}

FixedPointing PointingOf(const v1::Telemetry& spec) {
  FixedPointing fixed;
  if (spec.hfov_deg() > 0.0) fixed.hfov_deg = spec.hfov_deg();
  if (spec.has_yaw_deg()) fixed.yaw_deg = spec.yaw_deg();
  if (spec.has_pitch_deg()) fixed.pitch_deg = spec.pitch_deg();
  if (spec.has_roll_deg()) fixed.roll_deg = spec.roll_deg();
  return fixed;
}

// Takes the audit's verdict over: poses or corners are used, or a note says why not.
void Judge(TelemetryAudit audit, v1::TelemetrySource source, const std::string& path, FoundTelemetry* found) {
  for (const std::string& doubt : audit.doubts) found->notes.push_back(MakeNote(v1::WARNING, "telemetry_suspicious", path, doubt));
  if (audit.verdict == AuditVerdict::kRefused) {
    found->notes.push_back(MakeNote(v1::WARNING, "telemetry_refused", path, "the telemetry is not used: " + audit.explanation));
    return;
  }
  const bool corners = audit.verdict == AuditVerdict::kCorners;
  found->notes.push_back(
      MakeNote(corners ? v1::WARNING : v1::INFO, corners ? "telemetry_corners_only" : "telemetry_convention", path, audit.explanation));
  found->source = source;
  found->path = path;
  found->audit = std::move(audit);
}

class Finder {
 public:
  Finder(const v1::Sortie& sortie, int width_px, int height_px) : sortie_(sortie), width_px_(width_px), height_px_(height_px) {}

  Result<FoundTelemetry> Find() {
    if (sortie_.telemetry().ignore()) return std::move(found_);
    const std::string& named = sortie_.telemetry().path();
    if (LowerExtension(named) == ".srt" || LowerExtension(named) == ".gpx") {
      TREM_RETURN_IF_ERROR(ReadTrackFile(named));
      return std::move(found_);
    }
    const std::optional<std::string> csv = FindTelemetryCsv(sortie_);
    if (csv.has_value()) {
      TREM_ASSIGN_OR_RETURN(found_.table, ReadTelemetryCsv(*csv));
      found_.source = v1::TELEMETRY_CSV;
      found_.path = *csv;
      return std::move(found_);
    }
    if (IsVideo(sortie_)) {
      TREM_RETURN_IF_ERROR(FindKlv());
      if (found_.source == v1::TELEMETRY_NONE) TREM_RETURN_IF_ERROR(FindTrackFile());
    } else {
      TREM_RETURN_IF_ERROR(FindPhotos());
    }
    return std::move(found_);
  }

 private:
  // Fills in what the user knows, audits, and judges.
  Status Use(std::vector<TelemetryRecord> records, bool absolute, v1::TelemetrySource source, const std::string& path) {
    FillPointing(PointingOf(sortie_.telemetry()), &records);
    AuditOptions options;
    options.aspect = static_cast<double>(width_px_) / height_px_;
    options.absolute = absolute;
    if (sortie_.telemetry().has_ground_elevation_m()) options.ground_elevation_m = sortie_.telemetry().ground_elevation_m();
    std::optional<GriddedGround> surface;
    if (!sortie_.telemetry().dem_path().empty()) {
      TREM_ASSIGN_OR_RETURN(surface, GroundAround(sortie_.telemetry().dem_path(), records));
      options.surface = &*surface;
    }
    found_.utc = UtcClock(records);
    Judge(AuditTelemetry(records, options), source, path, &found_);
    return {};
  }

  Status FindKlv() {
    const std::string& path = sortie_.source().path();
    Result<KlvTelemetry> klv = ReadKlvTelemetry(path);
    // What cannot be opened is the frame reader's to report.
    if (!klv.ok()) return {};
    found_.notes.insert(found_.notes.end(), klv->notes.begin(), klv->notes.end());
    if (klv->chosen < 0) return {};
    const KlvStreamContent& content = klv->streams[klv->chosen];
    TREM_RETURN_IF_ERROR(Use(content.records, false, v1::TELEMETRY_KLV, path));
    if (found_.source == v1::TELEMETRY_KLV) found_.time_base_s = content.counts_from_first ? 0.0 : klv->time_base_s;
    return {};
  }

  Status FindTrackFile() {
    for (const std::filesystem::path& path : TrackFilesBeside(sortie_)) {
      const Status status = ReadTrackFile(path.string());
      // Subtitles may be anything: what nobody named may be unreadable.
      if (status.ok()) return {};
      if (!sortie_.telemetry().dem_path().empty()) return status;
      found_.notes.push_back(MakeNote(v1::WARNING, "telemetry_refused", path.string(), "the telemetry is not used: " + status.message()));
    }
    return {};
  }

  Status ReadTrackFile(const std::string& path) {
    const bool srt = LowerExtension(path) == ".srt";
    TREM_ASSIGN_OR_RETURN(const std::string text, ReadFile(path, srt ? kSrtBytesMax : kGpxBytesMax));
    std::vector<TelemetryRecord> records;
    if (srt) {
      TREM_ASSIGN_OR_RETURN(records, ParseDjiSrt(text, path, static_cast<double>(width_px_) / height_px_));
    } else {
      TREM_ASSIGN_OR_RETURN(records, ParseGpx(text, path));
    }
    return Use(std::move(records), true, srt ? v1::TELEMETRY_SRT : v1::TELEMETRY_GPX, path);
  }

  Status FindPhotos() {
    const std::string& path = sortie_.source().path();
    const Result<PhotoTelemetry> photos = ReadPhotoTelemetry(path, width_px_, height_px_);
    if (!photos.ok() || photos->names.empty()) return {};
    found_.notes.insert(found_.notes.end(), photos->notes.begin(), photos->notes.end());
    TREM_RETURN_IF_ERROR(Use(photos->records, true, v1::TELEMETRY_EXIF, path));
    if (found_.source == v1::TELEMETRY_NONE) return {};
    TelemetryTable table;
    table.has_pose = true;
    for (const CameraSample& pose : found_.audit.poses) {
      const auto number = static_cast<std::size_t>(pose.time_s + 0.5);
      TelemetryRow row;
      row.line = static_cast<int>(number) + 1;
      row.frame = photos->names[number];
      if (!photos->times_s.empty()) row.time_s = photos->times_s[number];
      if (photos->records[number].utc_us.has_value()) row.utc_us = PlausibleUtc(*photos->records[number].utc_us);
      row.pose = TelemetryPose{pose.latitude_deg, pose.longitude_deg, pose.altitude_m, pose.yaw_deg,
                               pose.pitch_deg,    pose.roll_deg,      pose.hfov_deg,   pose.vfov_deg};
      if (found_.audit.ground_known) row.ground_elevation_m = found_.audit.ground_elevation_m;
      table.rows.push_back(std::move(row));
    }
    found_.table = std::move(table);
    return {};
  }

  const v1::Sortie& sortie_;
  int width_px_;
  int height_px_;
  FoundTelemetry found_;
};

}  // namespace

std::vector<std::filesystem::path> TrackFilesBeside(const v1::Sortie& sortie) {
  std::vector<std::filesystem::path> files;
  if (!IsVideo(sortie)) return files;
  std::error_code error;
  for (const char* extension : {".srt", ".SRT", ".gpx", ".GPX"}) {
    const std::filesystem::path path = std::filesystem::path(sortie.source().path()).replace_extension(extension);
    if (std::filesystem::is_regular_file(path, error)) files.push_back(path);
  }
  return files;
}

Result<FoundTelemetry> FindTelemetry(const v1::Sortie& sortie, int width_px, int height_px) {
  return Finder(sortie, width_px, height_px).Find();
}

}  // namespace trem
