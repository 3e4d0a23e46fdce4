#include "worker/app/sortie_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "mosaic/geometry/camera.h"
#include "proto/codec/convert.h"

namespace trem {
namespace {

constexpr double kRadPerDeg = M_PI / 180.0;
// WGS 84, on average: a footprint needs no more.
constexpr double kMetresPerDegree = 111320.0;

double Quantile(std::vector<double> values, double p) {
  if (values.empty()) return 0.0;
  const auto rank = values.begin() + static_cast<std::ptrdiff_t>(p * static_cast<double>(values.size() - 1) + 0.5);
  std::nth_element(values.begin(), rank, values.end());
  return *rank;
}

// A frame's ground corners, longitude and latitude pairs [deg], and its ground sample distance.
struct FrameGround {
  std::vector<double> lon_lat_deg;
  double gsd_m = 0.0;
};

// Nothing when a corner of the image sees no ground.
std::optional<FrameGround> GroundOfPose(const v1::SortieManifest& manifest, const v1::Pose& pose) {
  const auto width = static_cast<int>(manifest.width_px());
  const auto height = static_cast<int>(manifest.height_px());
  const CameraIntrinsics intrinsics{width, height, FocalFromHorizontalFov(width, pose.hfov_deg() * kRadPerDeg)};
  CameraPose camera;
  camera.position_m = {0.0, 0.0, pose.altitude_m()};
  camera.yaw_rad = pose.yaw_deg() * kRadPerDeg;
  camera.pitch_rad = pose.pitch_deg() * kRadPerDeg;
  camera.roll_rad = pose.roll_deg() * kRadPerDeg;
  FrameGround ground;
  const double metres_per_longitude = kMetresPerDegree * std::max(0.01, std::cos(pose.latitude_deg() * kRadPerDeg));
  for (const auto& corner : {Eigen::Vector2d(-0.5, -0.5), Eigen::Vector2d(width - 0.5, -0.5), Eigen::Vector2d(width - 0.5, height - 0.5),
                             Eigen::Vector2d(-0.5, height - 0.5)}) {
    const std::optional<Eigen::Vector2d> metres = IntersectGround(camera, intrinsics, manifest.ground_elevation_m(), corner);
    if (!metres.has_value()) return std::nullopt;
    ground.lon_lat_deg.push_back(pose.longitude_deg() + metres->x() / metres_per_longitude);
    ground.lon_lat_deg.push_back(pose.latitude_deg() + metres->y() / kMetresPerDegree);
  }
  const Homography ground_from_sensor = GroundFromSensor(camera, intrinsics, manifest.ground_elevation_m());
  const Affine centre = ground_from_sensor.LinearisedAt({0.5 * (width - 1), 0.5 * (height - 1)});
  ground.gsd_m = std::sqrt(std::abs(centre.linear.determinant()));
  return ground;
}

FrameGround GroundOfCorners(const v1::SortieManifest& manifest, const google::protobuf::RepeatedField<double>& corners) {
  FrameGround ground;
  ground.lon_lat_deg.assign(corners.begin(), corners.end());
  const double metres_per_longitude = kMetresPerDegree * std::cos(corners[1] * kRadPerDeg);
  const double top_m = std::hypot((corners[2] - corners[0]) * metres_per_longitude, (corners[3] - corners[1]) * kMetresPerDegree);
  const double bottom_m = std::hypot((corners[4] - corners[6]) * metres_per_longitude, (corners[5] - corners[7]) * kMetresPerDegree);
  ground.gsd_m = 0.5 * (top_m + bottom_m) / manifest.width_px();
  return ground;
}

std::optional<SortieReport::Footprint> FindFootprint(const v1::SortieManifest& manifest) {
  SortieReport::Footprint footprint;
  std::vector<double> gsds_m;
  for (const v1::ManifestFrame& frame : manifest.frames()) {
    std::optional<FrameGround> ground;
    if (frame.has_pose()) {
      ground = GroundOfPose(manifest, frame.pose());
      if (!ground.has_value()) ++footprint.beyond_horizon_count;
    } else if (frame.corner_lon_lat_deg_size() == 8) {
      ground = GroundOfCorners(manifest, frame.corner_lon_lat_deg());
    }
    if (!ground.has_value()) continue;
    for (std::size_t i = 0; i < 8; i += 2) {
      const double lon = ground->lon_lat_deg[i];
      const double lat = ground->lon_lat_deg[i + 1];
      const bool is_first = footprint.frame_count == 0 && i == 0;
      footprint.west_deg = is_first ? lon : std::min(footprint.west_deg, lon);
      footprint.east_deg = is_first ? lon : std::max(footprint.east_deg, lon);
      footprint.south_deg = is_first ? lat : std::min(footprint.south_deg, lat);
      footprint.north_deg = is_first ? lat : std::max(footprint.north_deg, lat);
    }
    ++footprint.frame_count;
    gsds_m.push_back(ground->gsd_m);
  }
  if (footprint.frame_count == 0) return std::nullopt;
  footprint.gsd_m = Quantile(std::move(gsds_m), 0.5);
  return footprint;
}

void CountStates(const v1::SortieManifest& manifest, SortieReport* report) {
  for (const v1::ManifestFrame& frame : manifest.frames()) {
    switch (frame.state()) {
      case v1::FRAME_UNREADABLE:
        ++report->unreadable_count;
        break;
      case v1::FRAME_WRONG_SIZE:
        ++report->wrong_size_count;
        break;
      case v1::FRAME_BLANK:
        ++report->blank_count;
        break;
      case v1::FRAME_REPEATED:
        ++report->repeated_count;
        break;
      default:
        ++report->usable_count;
    }
    report->posed_count += frame.has_pose() ? 1 : 0;
    report->cornered_count += frame.corner_lon_lat_deg_size() == 8 ? 1 : 0;
  }
}

void MeasureMotion(const v1::SortieManifest& manifest, SortieReport* report) {
  std::vector<double> motions_px;
  std::vector<double> correlations;
  const Eigen::Vector2d centre(0.5 * (manifest.width_px() - 1.0), 0.5 * (manifest.height_px() - 1.0));
  bool has_previous = false;
  for (const v1::ManifestFrame& frame : manifest.frames()) {
    if (frame.state() != v1::FRAME_USABLE) continue;
    report->link_count += has_previous ? 1 : 0;
    has_previous = true;
    const Result<Affine> motion = AffineFromProto(frame.previous_from_current(), "previous_from_current");
    if (frame.motion_correlation() <= 0.0 || !motion.ok()) continue;
    motions_px.push_back(((*motion) * centre - centre).norm());
    correlations.push_back(frame.motion_correlation());
  }
  report->failed_link_count = report->link_count - static_cast<int>(motions_px.size());
  report->correlation_low = Quantile(correlations, 0.05);
  report->motion_median_px = Quantile(motions_px, 0.5);
  report->motion_max_px = Quantile(std::move(motions_px), 1.0);
}

std::string StatesText(const SortieReport& report) {
  std::string text;
  const auto add = [&text](int count, const char* what) {
    if (count > 0) text += fmt::format(", {} {}", count, what);
  };
  add(report.unreadable_count, "unreadable");
  add(report.wrong_size_count, "of another size");
  add(report.blank_count, "blank");
  add(report.repeated_count, "repeated");
  return text;
}

const char* SourceName(v1::TelemetrySource source) {
  switch (source) {
    case v1::TELEMETRY_CSV:
      return "csv";
    case v1::TELEMETRY_KLV:
      return "klv";
    case v1::TELEMETRY_EXIF:
      return "exif";
    case v1::TELEMETRY_SRT:
      return "srt";
    case v1::TELEMETRY_GPX:
      return "gpx";
    default:
      return "none";
  }
}

std::string TelemetryText(const v1::SortieManifest& manifest, const SortieReport& report) {
  if (manifest.telemetry_source() == v1::TELEMETRY_NONE) return "none; the mosaic will lie in local coordinates";
  std::string text = manifest.telemetry_path();
  if (manifest.telemetry_source() == v1::TELEMETRY_KLV) text += ", KLV";
  if (manifest.telemetry_source() == v1::TELEMETRY_EXIF) text += ", EXIF and XMP";
  if (report.posed_count > 0) text += fmt::format(", camera poses for {} of {} frames", report.posed_count, report.frame_count);
  if (report.cornered_count > 0) text += fmt::format(", image corners for {} of {} frames", report.cornered_count, report.frame_count);
  if (manifest.has_ground()) text += ", ground from " + manifest.ground().path();
  if (report.posed_count > 0) text += " (yaw from true north, pitch -90 looks down, WGS 84)";
  return text;
}

std::string FormatFootprint(const SortieReport& report) {
  if (!report.footprint.has_value()) return "";
  const SortieReport::Footprint& f = *report.footprint;
  const double metres_per_longitude = kMetresPerDegree * std::cos(0.5 * (f.south_deg + f.north_deg) * kRadPerDeg);
  std::string text = fmt::format(
      "footprint  longitude {:.6f} to {:.6f}, latitude {:.6f} to {:.6f} (about {:.0f} x {:.0f} m)\n"
      "           ground sample distance {:.3f} m at the image centre\n",
      f.west_deg, f.east_deg, f.south_deg, f.north_deg, (f.east_deg - f.west_deg) * metres_per_longitude,
      (f.north_deg - f.south_deg) * kMetresPerDegree, f.gsd_m);
  if (f.beyond_horizon_count > 0)
    text += fmt::format("           {} frames see the horizon and are left out of it\n", f.beyond_horizon_count);
  return text;
}

std::string SensorText(const v1::SortieManifest& manifest, const SortieReport& report) {
  const v1::SensorManifest& sensor = manifest.sensor();
  std::string text = "sensor     ";
  if (sensor.psf_sigma_error_px() > 0.0) {
    text += fmt::format("PSF sigma {:.2f} +- {:.2f} px, estimated; ", sensor.psf_sigma_px(), sensor.psf_sigma_error_px());
  } else if (sensor.psf_sigma_px() > 0.0) {
    text += fmt::format("PSF sigma {:.2f} px, assumed; ", sensor.psf_sigma_px());
  }
  if (sensor.optics_q() > 0.0) text += fmt::format("Q {:.2f}; ", sensor.optics_q());
  text += fmt::format("resolves at best {:.2f} cycles/px", sensor.ceiling_cycles_per_px());
  if (report.footprint.has_value() && sensor.ceiling_cycles_per_px() > 0.0) {
    text += fmt::format(", periods of {:.3g} m", report.footprint->gsd_m / sensor.ceiling_cycles_per_px());
  }
  return text + fmt::format(" ({})\n", sensor.ceiling_limit());
}

}  // namespace

SortieReport ReportOn(const v1::SortieManifest& manifest) {
  SortieReport report;
  report.frame_count = manifest.frames_size();
  CountStates(manifest, &report);
  MeasureMotion(manifest, &report);
  std::vector<double> intervals_s;
  for (int i = 1; i < manifest.frames_size(); ++i) intervals_s.push_back(manifest.frames(i).time_s() - manifest.frames(i - 1).time_s());
  const double interval_s = Quantile(std::move(intervals_s), 0.5);
  if (interval_s > 0.0) report.frame_rate_hz = 1.0 / interval_s;
  if (report.frame_count > 1) report.duration_s = manifest.frames(report.frame_count - 1).time_s() - manifest.frames(0).time_s();
  report.footprint = FindFootprint(manifest);
  return report;
}

std::string FormatReport(const v1::SortieManifest& manifest, const SortieReport& report) {
  const Roi valid = FromProto(manifest.valid_roi());
  std::string text = fmt::format("source     {} ({}{})\n", manifest.source_path(), manifest.source_kind() == v1::VIDEO ? "video" : "images",
                                 manifest.deinterlaced() ? ", deinterlaced" : "");
  text += fmt::format("frames     {}, {} usable{}; {} x {} px", report.frame_count, report.usable_count, StatesText(report),
                      manifest.width_px(), manifest.height_px());
  text += valid.width() == static_cast<int>(manifest.width_px()) && valid.height() == static_cast<int>(manifest.height_px())
              ? "\n"
              : fmt::format(", {} x {} without black borders\n", valid.width(), valid.height());
  text += fmt::format("time       {:.2f} s, {:.3g} frames/s\n", report.duration_s, report.frame_rate_hz);
  text += fmt::format("grey       {}, noise sigma {:.2f} grey levels\n",
                      manifest.grey_max() == 255.0     ? "8 bit"
                      : manifest.grey_max() == 65535.0 ? "16 bit"
                                                       : "floating point",
                      manifest.noise_sigma() * manifest.grey_scale());
  text += SensorText(manifest, report);
  text += fmt::format("motion     median {:.2f} px, largest {:.1f} px; {} of {} pairs of frames registered", report.motion_median_px,
                      report.motion_max_px, report.link_count - report.failed_link_count, report.link_count);
  text +=
      report.link_count > report.failed_link_count ? fmt::format(" (correlation {:.2f} or more for 95 %)\n", report.correlation_low) : "\n";
  text += fmt::format("pieces     {}\n", manifest.spans_size());
  for (const v1::FrameSpan& span : manifest.spans()) {
    if (manifest.spans_size() == 1) break;
    text +=
        fmt::format("           frames {} to {}, {:.2f} s to {:.2f} s\n", span.begin(), span.end() - 1,
                    manifest.frames(static_cast<int>(span.begin())).time_s(), manifest.frames(static_cast<int>(span.end()) - 1).time_s());
  }
  text += "telemetry  " + TelemetryText(manifest, report) + "\n";
  text += FormatFootprint(report);
  for (const v1::Note& note : manifest.notes()) {
    text += fmt::format("{}    {}\n", note.severity() == v1::WARNING ? "warning" : "note   ", note.message());
  }
  return text;
}

namespace {

nlohmann::ordered_json ReportAsJson(const v1::SortieManifest& manifest, const SortieReport& report) {
  nlohmann::ordered_json json = {
      {"source", manifest.source_path()},
      {"kind", manifest.source_kind() == v1::VIDEO ? "video" : "images"},
      {"frames", report.frame_count},
      {"usable", report.usable_count},
      {"unreadable", report.unreadable_count},
      {"wrong_size", report.wrong_size_count},
      {"blank", report.blank_count},
      {"repeated", report.repeated_count},
      {"width_px", manifest.width_px()},
      {"height_px", manifest.height_px()},
      {"valid_roi", {manifest.valid_roi().x0(), manifest.valid_roi().y0(), manifest.valid_roi().x1(), manifest.valid_roi().y1()}},
      {"deinterlaced", manifest.deinterlaced()},
      {"duration_s", report.duration_s},
      {"frame_rate_hz", report.frame_rate_hz},
      {"grey_max", manifest.grey_max()},
      {"noise_sigma", manifest.noise_sigma() * manifest.grey_scale()},
      {"psf_sigma_px", manifest.sensor().psf_sigma_px()},
      {"psf_sigma_error_px", manifest.sensor().psf_sigma_error_px()},
      {"optics_q", manifest.sensor().optics_q()},
      {"ceiling_cycles_per_px", manifest.sensor().ceiling_cycles_per_px()},
      {"ceiling_limit", manifest.sensor().ceiling_limit()},
      {"motion_median_px", report.motion_median_px},
      {"motion_max_px", report.motion_max_px},
      {"links", report.link_count},
      {"failed_links", report.failed_link_count},
      {"telemetry", manifest.telemetry_path()},
      {"telemetry_source", SourceName(manifest.telemetry_source())},
      {"telemetry_summary", manifest.telemetry_summary()},
      {"poses", report.posed_count},
      {"corners", report.cornered_count},
      {"ground_elevation_m", manifest.ground_elevation_m()}};
  json["footprint"] = nullptr;
  if (report.footprint.has_value()) {
    const SortieReport::Footprint& f = *report.footprint;
    json["footprint"] = {{"west_deg", f.west_deg},
                         {"south_deg", f.south_deg},
                         {"east_deg", f.east_deg},
                         {"north_deg", f.north_deg},
                         {"gsd_m", f.gsd_m},
                         {"frames", f.frame_count},
                         {"beyond_horizon", f.beyond_horizon_count}};
  }
  json["pieces"] = nlohmann::ordered_json::array();
  for (const v1::FrameSpan& span : manifest.spans()) json["pieces"].push_back({{"begin", span.begin()}, {"end", span.end()}});
  json["notes"] = nlohmann::ordered_json::array();
  for (const v1::Note& note : manifest.notes()) {
    json["notes"].push_back({{"severity", note.severity() == v1::WARNING ? "warning" : "info"},
                             {"code", note.code()},
                             {"subject", note.subject()},
                             {"message", note.message()}});
  }
  return json;
}

}  // namespace

std::string FormatReportAsJson(const v1::SortieManifest& manifest, const SortieReport& report) {
  return ReportAsJson(manifest, report).dump(2) + "\n";
}

std::string FormatReports(const std::vector<v1::SortieManifest>& manifests, const std::vector<SortieReport>& reports) {
  if (manifests.size() == 1) return FormatReport(manifests.front(), reports.front());
  std::string text;
  for (std::size_t k = 0; k < manifests.size(); ++k) {
    text += fmt::format("{}recording {} of {}\n", k == 0 ? "" : "\n", k + 1, manifests.size());
    text += FormatReport(manifests[k], reports[k]);
  }
  return text;
}

std::string FormatReportsAsJson(const std::vector<v1::SortieManifest>& manifests, const std::vector<SortieReport>& reports) {
  if (manifests.size() == 1) return FormatReportAsJson(manifests.front(), reports.front());
  nlohmann::ordered_json json;
  for (std::size_t k = 0; k < manifests.size(); ++k) json["recordings"].push_back(ReportAsJson(manifests[k], reports[k]));
  return json.dump(2) + "\n";
}

}  // namespace trem
