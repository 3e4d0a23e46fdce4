#include "worker/sortie/sortie_ground.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include "mosaic/raster/elevation_model.h"
#include "worker/sortie/frame_source.h"

namespace trem {
namespace {

constexpr double kRad = std::numbers::pi / 180.0;
constexpr double kMetresPerDegree = 111320.0;
// How far around a camera the ground is looked for when nothing tells where it looks, in camera altitudes, and its limits.
constexpr double kAltitudes = 6.0;
constexpr double kMarginMin_m = 2000.0;
constexpr double kMarginMax_m = 40000.0;
constexpr int kFramesTried = 400;

class Box {
 public:
  void Add(const GeoPoint& at) {
    west_ = std::min(west_, at.longitude_deg);
    east_ = std::max(east_, at.longitude_deg);
    south_ = std::min(south_, at.latitude_deg);
    north_ = std::max(north_, at.latitude_deg);
  }
  bool empty() const { return west_ > east_; }
  GeographicBounds Grown(double margin_m) const {
    const double north_deg = margin_m / kMetresPerDegree;
    const double east_deg = north_deg / std::max(0.01, std::cos(0.5 * (south_ + north_) * kRad));
    return {west_ - east_deg, std::max(-90.0, south_ - north_deg), east_ + east_deg, std::min(90.0, north_ + north_deg)};
  }
  double side_m() const {
    return std::max((north_ - south_) * kMetresPerDegree, (east_ - west_) * kMetresPerDegree * std::cos(0.5 * (south_ + north_) * kRad));
  }
  GeoPoint middle() const { return {0.5 * (south_ + north_), 0.5 * (west_ + east_)}; }

 private:
  double west_ = std::numeric_limits<double>::infinity();
  double east_ = -west_;
  double south_ = west_;
  double north_ = -west_;
};

double MarginOf(double altitude_m) { return std::clamp(kAltitudes * altitude_m, kMarginMin_m, kMarginMax_m); }

// What the frames see of a coarse surface.
class Footprint {
 public:
  Footprint(const v1::SortieManifest& manifest) : manifest_(manifest) {}

  // Cameras' places and stated corners, grown by what the highest camera may overlook. Nothing: no frame has either.
  std::optional<GeographicBounds> Around() const {
    Box box;
    double highest_m = 0.0;
    for (const v1::ManifestFrame& frame : manifest_.frames()) {
      if (frame.has_pose()) {
        box.Add({frame.pose().latitude_deg(), frame.pose().longitude_deg()});
        highest_m = std::max(highest_m, frame.pose().altitude_m());
      } else if (frame.corner_lon_lat_deg_size() == 8) {
        for (int k = 0; k < 8; k += 2) box.Add({frame.corner_lon_lat_deg(k + 1), frame.corner_lon_lat_deg(k)});
      }
    }
    if (box.empty()) return std::nullopt;
    return box.Grown(MarginOf(highest_m));
  }

  Status See(const GriddedGround& coarse) {
    const Eigen::Vector2d middle =
        coarse.origin() +
        0.5 * Eigen::Vector2d(coarse.elevations_m().width() - 1, coarse.elevations_m().height() - 1).cwiseProduct(coarse.step());
    TREM_ASSIGN_OR_RETURN(const UtmFrame map, UtmFrame::ForPoint(middle.y(), middle.x()));
    TREM_ASSIGN_OR_RETURN(const Eigen::Vector2d origin, map.Forward(middle.y(), middle.x()));
    TREM_ASSIGN_OR_RETURN(const double scale, map.ScaleFactor(middle.y(), middle.x()));
    TREM_ASSIGN_OR_RETURN(const GriddedGround surface, GroundInWorld(coarse, map, origin, scale));
    const int stride = std::max(1, manifest_.frames_size() / kFramesTried);
    for (int i = 0; i < manifest_.frames_size(); i += stride) {
      const v1::ManifestFrame& frame = manifest_.frames(i);
      if (frame.has_pose()) {
        ++posed_count_;
        TREM_RETURN_IF_ERROR(SeePose(frame.pose(), map, origin, scale, surface));
      } else if (frame.corner_lon_lat_deg_size() == 8) {
        for (int k = 0; k < 8; k += 2) AddPoint({frame.corner_lon_lat_deg(k + 1), frame.corner_lon_lat_deg(k)}, coarse);
      }
    }
    return {};
  }

  const Box& box() const { return box_; }
  int posed_count() const { return posed_count_; }
  int missed_count() const { return missed_count_; }
  double MedianElevation() {
    const auto middle = elevations_m_.begin() + static_cast<std::ptrdiff_t>(elevations_m_.size() / 2);
    std::nth_element(elevations_m_.begin(), middle, elevations_m_.end());
    return *middle;
  }
  bool sees() const { return !elevations_m_.empty(); }

 private:
  void AddPoint(const GeoPoint& at, const GriddedGround& geographic) {
    box_.Add(at);
    const std::optional<double> z = geographic.ElevationAt({at.longitude_deg, at.latitude_deg});
    if (z.has_value()) elevations_m_.push_back(*z);
  }

  Status SeePose(const v1::Pose& pose, const UtmFrame& map, const Eigen::Vector2d& origin, double scale, const GriddedGround& surface) {
    const auto width = static_cast<int>(manifest_.width_px());
    const auto height = static_cast<int>(manifest_.height_px());
    TREM_ASSIGN_OR_RETURN(const Eigen::Vector2d at, map.Forward(pose.latitude_deg(), pose.longitude_deg()));
    TREM_ASSIGN_OR_RETURN(const double convergence_rad, map.ConvergenceRad(pose.latitude_deg(), pose.longitude_deg()));
    CameraPose camera;
    camera.position_m << (at - origin) / scale, pose.altitude_m();
    camera.yaw_rad = pose.yaw_deg() * kRad - convergence_rad;
    camera.pitch_rad = pose.pitch_deg() * kRad;
    camera.roll_rad = pose.roll_deg() * kRad;
    const CameraIntrinsics intrinsics{width, height, FocalFromHorizontalFov(width, pose.hfov_deg() * kRad)};
    bool missed = false;
    for (const auto& u : {Eigen::Vector2d(-0.5, -0.5), Eigen::Vector2d(width - 0.5, -0.5), Eigen::Vector2d(width - 0.5, height - 0.5),
                          Eigen::Vector2d(-0.5, height - 0.5), Eigen::Vector2d(0.5 * (width - 1), 0.5 * (height - 1))}) {
      const std::optional<Eigen::Vector3d> x = IntersectSurface(camera, intrinsics, surface, u);
      if (!x.has_value()) {
        missed = true;
        continue;
      }
      TREM_ASSIGN_OR_RETURN(const Eigen::Vector2d place, map.Inverse(origin + scale * x->head<2>()));
      box_.Add({place.x(), place.y()});
      elevations_m_.push_back(x->z());
    }
    missed_count_ += missed ? 1 : 0;
    return {};
  }

  const v1::SortieManifest& manifest_;
  Box box_;
  std::vector<double> elevations_m_;
  int posed_count_ = 0;
  int missed_count_ = 0;
};

void Keep(const GriddedGround& ground, const std::string& dem_path, v1::SortieManifest* manifest) {
  v1::GroundGrid* message = manifest->mutable_ground();
  message->set_path(dem_path);
  message->set_west_deg(ground.origin().x());
  message->set_north_deg(ground.origin().y());
  message->set_longitude_step_deg(ground.step().x());
  message->set_latitude_step_deg(ground.step().y());
  message->set_width(static_cast<std::uint32_t>(ground.elevations_m().width()));
  message->set_height(static_cast<std::uint32_t>(ground.elevations_m().height()));
  message->mutable_elevation_m()->Add(ground.elevations_m().pixels().begin(), ground.elevations_m().pixels().end());
}

}  // namespace

Result<GriddedGround> GroundAround(const std::string& dem_path, const std::vector<TelemetryRecord>& records) {
  Box box;
  double highest_m = 0.0;
  for (const TelemetryRecord& record : records) {
    if (record.sensor.has_value()) box.Add(*record.sensor);
    if (record.frame_centre.has_value()) box.Add(*record.frame_centre);
    highest_m = std::max({highest_m, record.altitude_msl_m.value_or(0.0), record.altitude_hae_m.value_or(0.0)});
  }
  if (box.empty()) return InvalidInput("telemetry.dem_path: the telemetry names no place at which to look into " + dem_path);
  return ReadElevationModel(dem_path, box.Grown(MarginOf(highest_m)));
}

Status AttachGround(const std::string& dem_path, v1::SortieManifest* manifest) {
  Footprint footprint(*manifest);
  const std::optional<GeographicBounds> around = footprint.Around();
  if (!around.has_value()) {
    *manifest->add_notes() = MakeNote(v1::WARNING, "dem_unused", dem_path, "the elevation model is not used: no frame has telemetry");
    return {};
  }
  TREM_ASSIGN_OR_RETURN(const GriddedGround coarse, ReadElevationModel(dem_path, *around));
  TREM_RETURN_IF_ERROR(footprint.See(coarse));
  if (!footprint.sees()) {
    return InvalidInput("elevation model " + dem_path +
                        ": no ray of any frame meets it: the cameras look above the horizon, stand below it, or look " +
                        "beyond its edge; check its vertical datum against the telemetry's altitudes");
  }
  // The margin is for what the alignment moves, and for errors of the poses.
  const double margin_m = 50.0 + 0.1 * footprint.box().side_m();
  TREM_ASSIGN_OR_RETURN(const GriddedGround fine, ReadElevationModel(dem_path, footprint.box().Grown(margin_m)));
  Keep(fine, dem_path, manifest);
  manifest->set_ground_elevation_m(footprint.MedianElevation());
  *manifest->add_notes() = MakeNote(
      v1::INFO, "dem", dem_path,
      fmt::format(
          "ground from the elevation model: {} x {} nodes {:.3g} m apart, {:.1f} to {:.1f} m, {:.1f} m in the median of what is seen",
          fine.elevations_m().width(), fine.elevations_m().height(), std::abs(fine.step().y()) * kMetresPerDegree, fine.lowest_m(),
          fine.highest_m(), manifest->ground_elevation_m()));
  if (footprint.missed_count() > 0) {
    *manifest->add_notes() = MakeNote(v1::WARNING, "dem_missed", dem_path,
                                      fmt::format("{} of {} frames that were tried see, in some corner, no ground of the elevation model",
                                                  footprint.missed_count(), footprint.posed_count()));
  }
  return {};
}

Result<std::optional<GriddedGround>> GroundOfManifest(const v1::SortieManifest& manifest) {
  if (!manifest.has_ground()) return std::optional<GriddedGround>();
  const v1::GroundGrid& ground = manifest.ground();
  const bool sized = ground.width() >= 2 && ground.height() >= 2 && ground.width() <= 4096 && ground.height() <= 4096 &&
                     static_cast<std::uint64_t>(ground.elevation_m_size()) == std::uint64_t{ground.width()} * ground.height();
  const bool stepped = std::isfinite(ground.west_deg()) && std::isfinite(ground.north_deg()) && ground.longitude_step_deg() > 0.0 &&
                       ground.latitude_step_deg() < 0.0;
  if (!sized || !stepped ||
      std::none_of(ground.elevation_m().begin(), ground.elevation_m().end(), [](float z) { return std::isfinite(z); })) {
    return Corrupt("manifest.ground is no grid of elevations: " + std::to_string(ground.elevation_m_size()) + " values for " +
                   std::to_string(ground.width()) + " x " + std::to_string(ground.height()) + " nodes");
  }
  Image<float> nodes(static_cast<int>(ground.width()), static_cast<int>(ground.height()));
  std::copy(ground.elevation_m().begin(), ground.elevation_m().end(), nodes.pixels().begin());
  return std::optional<GriddedGround>(
      GriddedGround({ground.west_deg(), ground.north_deg()}, {ground.longitude_step_deg(), ground.latitude_step_deg()}, std::move(nodes)));
}

}  // namespace trem
