#include "worker/tasks/align_input.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>

#include "mosaic/raster/crs.h"
#include "mosaic/raster/elevation_model.h"
#include "proto/codec/convert.h"
#include "worker/sortie/control_csv.h"
#include "worker/sortie/sortie_ground.h"

namespace trem {
namespace {

constexpr double kRad = std::numbers::pi / 180.0;
constexpr std::uint32_t kDefaultRatio = 3;

bool AllFinite(const google::protobuf::RepeatedField<double>& numbers) {
  return std::all_of(numbers.begin(), numbers.end(), [](double x) { return std::isfinite(x); });
}

// The 6x6 matrix of 21 numbers or the 8x8 one of 36, with eigenvalues kept within 1e-4 .. 100 px: a registration may claim less or
// more, but neither helps.
Result<align::CornerCovariance> CornerCovariance(const google::protobuf::RepeatedField<double>& numbers) {
  if ((numbers.size() != 21 && numbers.size() != 36) || !AllFinite(numbers)) {
    return Corrupt("corner_covariance_px2 has " + std::to_string(numbers.size()) + " numbers; expected 21 finite ones, or 36 of a projective view");
  }
  const int parameters = numbers.size() == 21 ? 6 : 8;
  align::CornerCovariance matrix(parameters, parameters);
  int next = 0;
  for (int row = 0; row < parameters; ++row) {
    for (int column = row; column < parameters; ++column) matrix(row, column) = matrix(column, row) = numbers[next++];
  }
  const Eigen::SelfAdjointEigenSolver<align::CornerCovariance> eigen(matrix);
  const Eigen::VectorXd values = eigen.eigenvalues().cwiseMax(1e-8).cwiseMin(1e4);
  return align::CornerCovariance(eigen.eigenvectors() * values.asDiagonal() * eigen.eigenvectors().transpose());
}

Result<align::ChainView> ViewFromProto(const v1::ChainView& message, std::uint32_t frame_count) {
  if (message.frame_index() >= frame_count) {
    return Corrupt("chain.frame_index is " + std::to_string(message.frame_index()) + "; the manifest has " + std::to_string(frame_count) +
                   " frames");
  }
  align::ChainView view;
  view.frame = message.frame_index();
  TREM_ASSIGN_OR_RETURN(view.scene_from_sensor, PlanarMapFromProto(message.scene_from_sensor(), "chain.scene_from_sensor"));
  TREM_ASSIGN_OR_RETURN(view.corner_covariance_px2, CornerCovariance(message.corner_covariance_px2()));
  view.gain = message.gain();
  view.offset = message.offset();
  const auto& covariance = message.gain_offset_covariance();
  if (!std::isfinite(view.gain) || !std::isfinite(view.offset) || covariance.size() != 3 || !AllFinite(covariance)) {
    return Corrupt("chain.gain, offset and gain_offset_covariance (3 numbers) are not all finite");
  }
  const double cov_max = std::sqrt(std::max(0.0, covariance[0]) * std::max(0.0, covariance[2]));
  const double cov = std::clamp(covariance[1], -cov_max, cov_max);
  view.gain_offset_covariance << std::max(0.0, covariance[0]), cov, cov, std::max(0.0, covariance[2]);
  return view;
}

Status AddWindow(const v1::WindowResult& window, std::uint32_t frame_count, AlignTaskInput& input) {
  for (const v1::Segment& message : window.segments()) {
    align::Segment segment;
    segment.window_id = window.window_id();
    segment.segment_id = message.segment_id();
    segment.roi_in_sensor = FromProto(window.roi_in_sensor());
    if (segment.roi_in_sensor.width() < 2 || segment.roi_in_sensor.height() < 2)
      return Corrupt("roi_in_sensor is smaller than 2 x 2 pixels");
    for (const v1::ChainView& view : message.chain()) {
      TREM_ASSIGN_OR_RETURN(align::ChainView converted, ViewFromProto(view, frame_count));
      segment.chain.push_back(std::move(converted));
    }
    for (const v1::EmittedScene& scene : message.scenes()) {
      const Roi roi = FromProto(scene.roi_in_scene());
      if (roi.width() < 2 || roi.height() < 2) return Corrupt("scene " + std::to_string(scene.scene_id()) + " is smaller than 2 x 2 cells");
      segment.scenes.push_back({scene.scene_id(), roi, scene.frame_begin(), scene.frame_end()});
      if (!input.rasters.emplace(std::pair(window.window_id(), scene.scene_id()), FromProto(scene.raster())).second) {
        return Corrupt("scene " + std::to_string(scene.scene_id()) + " occurs twice");
      }
    }
    if (!segment.scenes.empty() && segment.chain.empty())
      return Corrupt("segment " + std::to_string(message.segment_id()) + " has scenes but no chain");
    input.align.segments.push_back(std::move(segment));
  }
  return {};
}

bool HasCorners(const v1::ManifestFrame& frame) { return frame.corner_lon_lat_deg_size() == 8 && AllFinite(frame.corner_lon_lat_deg()); }

bool UsablePose(const v1::ManifestFrame& frame) {
  if (!frame.has_pose()) return false;
  const v1::Pose& pose = frame.pose();
  for (const double x :
       {pose.latitude_deg(), pose.longitude_deg(), pose.altitude_m(), pose.yaw_deg(), pose.pitch_deg(), pose.roll_deg(), pose.hfov_deg()}) {
    if (!std::isfinite(x)) return false;
  }
  return pose.hfov_deg() > 0.0 && pose.hfov_deg() < 180.0;
}

// Latitude and longitude of a frame with telemetry.
std::pair<double, double> PlaceOf(const v1::ManifestFrame& frame) {
  if (UsablePose(frame)) return {frame.pose().latitude_deg(), frame.pose().longitude_deg()};
  return {frame.corner_lon_lat_deg(1), frame.corner_lon_lat_deg(0)};
}

// Turns telemetry into anchors of the working world.
class AnchorMaker {
 public:
  AnchorMaker(const UtmFrame& map, const Eigen::Vector2d& origin, double scale) : map_(map), origin_(origin), scale_(scale) {}

  Result<align::FrameAnchor> Make(std::uint32_t index, const v1::ManifestFrame& frame, int width_px) const {
    align::FrameAnchor anchor;
    anchor.frame = index;
    if (UsablePose(frame)) {
      const v1::Pose& pose = frame.pose();
      TREM_ASSIGN_OR_RETURN(const Eigen::Vector2d at, Working(pose.latitude_deg(), pose.longitude_deg()));
      TREM_ASSIGN_OR_RETURN(const double convergence_rad, map_.ConvergenceRad(pose.latitude_deg(), pose.longitude_deg()));
      CameraPose camera;
      camera.position_m << at, pose.altitude_m();
      camera.yaw_rad = pose.yaw_deg() * kRad - convergence_rad;
      camera.pitch_rad = pose.pitch_deg() * kRad;
      camera.roll_rad = pose.roll_deg() * kRad;
      anchor.pose = camera;
      anchor.position_extra_m = std::max(0.0, pose.position_sigma_m());
      anchor.attitude_extra_rad = std::max(0.0, pose.attitude_sigma_deg()) * kRad;
      anchor.focal_px = FocalFromHorizontalFov(width_px, pose.hfov_deg() * kRad);
      return anchor;
    }
    std::array<Eigen::Vector2d, 4> corners;
    for (int k = 0; k < 4; ++k) {
      TREM_ASSIGN_OR_RETURN(corners[static_cast<std::size_t>(k)],
                            Working(frame.corner_lon_lat_deg(2 * k + 1), frame.corner_lon_lat_deg(2 * k)));
    }
    anchor.corners = corners;
    return anchor;
  }

  Result<align::ControlObservation> MakeControl(const v1::ControlObservation& message, const std::vector<std::string>& held_out) const {
    align::ControlObservation control;
    control.name = message.name();
    control.frame = message.frame_index();
    control.u = {message.x_px(), message.y_px()};
    TREM_ASSIGN_OR_RETURN(const Eigen::Vector2d at, Working(message.latitude_deg(), message.longitude_deg()));
    control.x_in_world << at, message.elevation_m();
    control.held_out = std::any_of(held_out.begin(), held_out.end(),
                                   [&](const std::string& name) { return name == "*" || name == control.name; });
    return control;
  }

 private:
  Result<Eigen::Vector2d> Working(double latitude_deg, double longitude_deg) const {
    TREM_ASSIGN_OR_RETURN(const Eigen::Vector2d x_in_map, map_.Forward(latitude_deg, longitude_deg));
    return Eigen::Vector2d((x_in_map - origin_) / scale_);
  }

  const UtmFrame& map_;
  Eigen::Vector2d origin_;
  double scale_;
};

// Which of the manifest's recordings frame `t` belongs to.
std::uint32_t RecordingOf(const v1::SortieManifest& manifest, std::uint32_t t) {
  for (int k = 0; k < manifest.recordings_size(); ++k) {
    if (t >= manifest.recordings(k).frame_begin() && t < manifest.recordings(k).frame_end()) return static_cast<std::uint32_t>(k);
  }
  return 0;
}

// Elevation of the ground below a place: of the elevation model, where there is one.
double GroundBelow(const std::optional<GriddedGround>& ground, const v1::Pose& pose, double level_m) {
  if (!ground) return level_m;
  return ground->ElevationAt({pose.longitude_deg(), pose.latitude_deg()}).value_or(ground->lowest_m());
}

// Poses that wander from the image motion are turned to follow it, but their average may be off by as much as they wander: that error is
// shared by a recording's frames. The manifest says it of each pose.
void AddWander(const v1::SortieManifest& manifest, const std::vector<std::uint32_t>& with_telemetry, align::AlignInput* input) {
  std::map<std::uint32_t, std::vector<double>> wander_rad;
  for (const std::uint32_t t : with_telemetry) {
    const v1::ManifestFrame& frame = manifest.frames(static_cast<int>(t));
    if (UsablePose(frame)) wander_rad[RecordingOf(manifest, t)].push_back(std::max(0.0, frame.pose().attitude_sigma_deg()) * kRad);
  }
  for (auto& [recording, of_frames] : wander_rad) {
    const auto middle = of_frames.begin() + static_cast<std::ptrdiff_t>(of_frames.size() / 2);
    std::nth_element(of_frames.begin(), middle, of_frames.end());
    align::TelemetrySigmas sigmas = input->SigmasOf(recording);
    sigmas.attitude_rad = std::hypot(sigmas.attitude_rad, *middle);
    input->recordings[recording] = sigmas;
  }
}

Status AddTelemetry(const v1::Sortie& sortie, const v1::SortieManifest& manifest, AlignTaskInput& input) {
  TREM_ASSIGN_OR_RETURN(const std::optional<GriddedGround> ground, GroundOfManifest(manifest));
  std::vector<std::uint32_t> with_telemetry;
  std::vector<std::uint32_t> below_ground;
  for (std::uint32_t t = 0; t < static_cast<std::uint32_t>(manifest.frames_size()); ++t) {
    const v1::ManifestFrame& frame = manifest.frames(static_cast<int>(t));
    const bool pose = UsablePose(frame);
    if (pose && !(frame.pose().altitude_m() > GroundBelow(ground, frame.pose(), input.align.ground_z_m))) {
      below_ground.push_back(t);
    } else if (pose || HasCorners(frame)) {
      with_telemetry.push_back(t);
    }
  }
  if (!below_ground.empty()) {
    input.notes.push_back(
        MakeNote("camera_below_ground", "frame " + manifest.frames(static_cast<int>(below_ground.front())).name(),
                 std::to_string(below_ground.size()) + " frames have an altitude at or below the ground elevation of " +
                     (ground ? "the elevation model " + manifest.ground().path() : std::to_string(input.align.ground_z_m) + " m") +
                     "; their telemetry is not used. Set telemetry." + (ground ? "dem_path to a model" : "ground_elevation_m") +
                     " in the datum of altitude_m",
                 v1::WARNING));
  }
  if (with_telemetry.empty() || sortie.telemetry().ignore()) return {};
  const auto [latitude_deg, longitude_deg] = PlaceOf(manifest.frames(static_cast<int>(with_telemetry[with_telemetry.size() / 2])));
  Result<UtmFrame> map =
      sortie.mosaic().crs().empty() ? UtmFrame::ForPoint(latitude_deg, longitude_deg) : UtmFrame::ForCrs(sortie.mosaic().crs());
  if (!map.ok()) return map.status().WithPrefix("mosaic.crs");
  TREM_ASSIGN_OR_RETURN(Eigen::Vector2d origin, map->Forward(latitude_deg, longitude_deg));
  origin = origin.array().round();
  TREM_ASSIGN_OR_RETURN(input.scale, map->ScaleFactor(latitude_deg, longitude_deg));
  input.crs_wkt = map->wkt();
  input.map_from_working.matrix << input.scale, 0.0, origin.x(), 0.0, input.scale, origin.y(), 0.0, 0.0, 1.0;
  if (ground) {
    TREM_ASSIGN_OR_RETURN(GriddedGround in_world, GroundInWorld(*ground, *map, origin, input.scale));
    input.align.ground = std::make_shared<GriddedGround>(std::move(in_world));
  }
  AddWander(manifest, with_telemetry, &input.align);
  const AnchorMaker maker(*map, origin, input.scale);
  for (const std::uint32_t t : with_telemetry) {
    Result<align::FrameAnchor> anchor = maker.Make(t, manifest.frames(static_cast<int>(t)), input.align.width_px);
    if (!anchor.ok()) return anchor.status().WithPrefix("frame " + manifest.frames(static_cast<int>(t)).name());
    anchor->recording = RecordingOf(manifest, t);
    input.align.anchors.push_back(std::move(*anchor));
  }
  const std::vector<std::string> held_out = HeldOutNames(sortie.control());
  for (const v1::ControlObservation& control : manifest.control()) {
    Result<align::ControlObservation> observation = maker.MakeControl(control, held_out);
    if (!observation.ok()) return observation.status().WithPrefix("control point " + control.name());
    input.align.control.push_back(std::move(*observation));
  }
  input.telemetry = true;
  return {};
}

align::Boresight BoresightOf(v1::Correction correction) {
  if (correction == v1::CORRECTION_ON) return align::Boresight::kEstimated;
  return correction == v1::CORRECTION_OFF ? align::Boresight::kHeld : align::Boresight::kWhereSeen;
}

}  // namespace

v1::Note MakeNote(const std::string& code, const std::string& subject, const std::string& message, v1::Severity severity) {
  v1::Note note;
  note.set_code(code);
  note.set_subject(subject);
  note.set_message(message);
  note.set_severity(severity);
  return note;
}

Result<AlignTaskInput> MakeAlignInput(const v1::Sortie& sortie, const v1::SortieManifest& manifest,
                                      const std::vector<v1::WindowResult>& windows) {
  AlignTaskInput input;
  input.crs_wkt = LocalPixelCrsWkt();
  align::AlignInput& align = input.align;
  align.width_px = static_cast<int>(manifest.width_px());
  align.height_px = static_cast<int>(manifest.height_px());
  if (align.width_px < 2 || align.height_px < 2 || align.width_px > (1 << 20) || align.height_px > (1 << 20)) {
    return Corrupt("the manifest's frames are " + std::to_string(manifest.width_px()) + " x " + std::to_string(manifest.height_px()) +
                   " pixels");
  }
  align.ratio = static_cast<int>(sortie.tre().ratio() > 0 ? sortie.tre().ratio() : kDefaultRatio);
  align.ground_z_m = sortie.telemetry().has_ground_elevation_m() ? sortie.telemetry().ground_elevation_m() : manifest.ground_elevation_m();
  if (sortie.telemetry().position_sigma_m() > 0.0) align.position_sigma_m = sortie.telemetry().position_sigma_m();
  if (sortie.telemetry().attitude_sigma_deg() > 0.0) align.attitude_sigma_rad = sortie.telemetry().attitude_sigma_deg() * kRad;
  align.focal_sigma = 0.01 * sortie.telemetry().focal_sigma_percent();
  align.estimate_distortion = sortie.telemetry().estimate_distortion();
  align.boresight = BoresightOf(sortie.telemetry().boresight());
  if (sortie.control().pixel_sigma_px() > 0.0) align.control_sigma_px = sortie.control().pixel_sigma_px();
  if (sortie.control().survey_sigma_m() > 0.0) align.control_sigma_m = sortie.control().survey_sigma_m();
  for (int k = 1; k < manifest.recordings_size(); ++k) {
    const v1::RecordingManifest& recording = manifest.recordings(k);
    if (!(recording.position_sigma_m() > 0.0) || !(recording.attitude_sigma_deg() > 0.0))
      return Corrupt("manifest.recordings[" + std::to_string(k) + "]: its sigmas are not positive");
    align.recordings[static_cast<std::uint32_t>(k)] = {recording.position_sigma_m(), recording.attitude_sigma_deg() * kRad};
  }
  for (const v1::WindowResult& window : windows) {
    const Status status = AddWindow(window, static_cast<std::uint32_t>(manifest.frames_size()), input);
    if (!status.ok()) return status.WithPrefix("window " + std::to_string(window.window_id()));
  }
  if (!sortie.mosaic().crs().empty()) TREM_RETURN_IF_ERROR(UtmFrame::ForCrs(sortie.mosaic().crs()).status().WithPrefix("mosaic.crs"));
  TREM_RETURN_IF_ERROR(AddTelemetry(sortie, manifest, input));
  return input;
}

}  // namespace trem
