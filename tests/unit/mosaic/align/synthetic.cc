#include "tests/unit/mosaic/align/synthetic.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "mosaic/align/align_graph.h"
#include "mosaic/base/check.h"
#include "mosaic/base/rng.h"

namespace trem::align {
namespace {

constexpr double kRad = std::numbers::pi / 180.0;
constexpr int kWidth = 256;
constexpr int kHeight = 200;
constexpr double kAltitudeM = 400.0;
constexpr int kWindowFrames = 20;
constexpr int kWindowOverlap = 6;
constexpr int kEmitEvery = 7;

CameraPose TruePose(const SyntheticOptions& options, int t, double leg_spacing_m, Rng& rng) {
  const int leg = options.leg_frames > 0 ? t / options.leg_frames : 0;
  const int along = options.leg_frames > 0 ? t % options.leg_frames : t;
  const double step = options.leg_frames > 0 && leg % 2 == 1 ? options.leg_frames - 1 - along : along;
  CameraPose pose;
  const double stand_off_m = kAltitudeM / std::tan(-options.pitch_deg * kRad);
  pose.position_m = {step * options.speed_m + 0.1 * rng.Normal(), leg * leg_spacing_m - stand_off_m + 0.1 * rng.Normal(),
                     kAltitudeM + 0.1 * rng.Normal()};
  pose.yaw_rad = options.roll_jitter_deg * kRad * rng.Normal();
  pose.pitch_rad = options.pitch_deg * kRad + options.roll_jitter_deg * kRad * rng.Normal();
  pose.roll_rad = options.roll_jitter_deg * kRad * rng.Normal();
  return pose;
}

void AddAnchors(const SyntheticOptions& options, const std::vector<CameraPose>& poses, double focal_px, SyntheticSortie& sortie) {
  Rng rng({options.seed, 2});
  const Eigen::Vector3d bias = options.position_bias_m * Eigen::Vector3d(rng.Normal(), rng.Normal(), rng.Normal());
  const Eigen::Vector3d attitude_bias = options.attitude_bias_deg * kRad * Eigen::Vector3d(rng.Normal(), rng.Normal(), rng.Normal());
  for (std::size_t t = 0; t < poses.size(); ++t) {
    CameraPose told = poses[t];
    for (int k = 0; k < 3; ++k) told.position_m(k) += bias(k) + options.position_white_m * rng.Normal();
    told.yaw_rad += attitude_bias.x() + options.attitude_white_deg * kRad * rng.Normal();
    told.pitch_rad += attitude_bias.y() + options.attitude_white_deg * kRad * rng.Normal();
    told.roll_rad += attitude_bias.z() + options.attitude_white_deg * kRad * rng.Normal();
    sortie.input.anchors.push_back({static_cast<std::uint32_t>(t), told, focal_px * (1.0 + options.focal_error)});
  }
}

// A plane that rises by `slope` to the north and to the east, with 0 at the world's origin.
std::shared_ptr<const GroundSurface> Slope(double slope) {
  constexpr double kReachM = 2000.0;
  Image<float> nodes(2, 2);
  for (int y = 0; y < 2; ++y) {
    for (int x = 0; x < 2; ++x) nodes.at(x, y) = static_cast<float>(slope * kReachM * (2 * (x + y) - 2));
  }
  return std::make_shared<GriddedGround>(Eigen::Vector2d(-kReachM, -kReachM), Eigen::Vector2d(2.0 * kReachM, 2.0 * kReachM), nodes);
}

// Waves along and across the flight, about 0.
std::shared_ptr<const GroundSurface> Hills(double amplitude_m) {
  constexpr double kReachM = 400.0, kStepM = 4.0, kLengthM = 60.0;
  const auto side = static_cast<int>(2.0 * kReachM / kStepM) + 1;
  Image<float> nodes(side, side);
  for (int y = 0; y < side; ++y) {
    for (int x = 0; x < side; ++x) {
      const double a = 2.0 * std::numbers::pi / kLengthM * kStepM;
      nodes.at(x, y) = static_cast<float>(amplitude_m * std::sin(a * x + 0.7) * std::cos(a * y));
    }
  }
  return std::make_shared<GriddedGround>(Eigen::Vector2d(-kReachM, -kReachM), Eigen::Vector2d(kStepM, kStepM), nodes);
}

// The affine map that fits best where a frame and the first one of its window see the same places of the hills.
Affine ViewOverHills(const SyntheticSortie& sortie, const Homography& scene_from_first, const CameraPose& frame, const CameraPose& first,
                     const Roi& roi) {
  const CameraIntrinsics intrinsics{kWidth, kHeight, sortie.focal_px};
  constexpr int kSide = 9;
  std::vector<Eigen::Vector2d> pixels, cells;
  for (int j = 0; j < kSide; ++j) {
    for (int i = 0; i < kSide; ++i) {
      const Eigen::Vector2d u(roi.x0 + (roi.width() - 1.0) * i / (kSide - 1), roi.y0 + (roi.height() - 1.0) * j / (kSide - 1));
      const Eigen::Vector3d place = *IntersectSurface(frame, intrinsics, *sortie.input.ground, u);
      pixels.push_back(u);
      const Eigen::Vector3d ray = WorldFromCamera(first.yaw_rad, first.pitch_rad, first.roll_rad).transpose() * (place - first.position_m);
      const Eigen::Vector2d seen(0.5 * (kWidth - 1) + sortie.focal_px * ray.x() / ray.z(),
                                 0.5 * (kHeight - 1) + sortie.focal_px * ray.y() / ray.z());
      cells.push_back(scene_from_first * seen);
    }
  }
  return *FitAffine(pixels, cells);
}

// Of a plane seen by a pinhole camera: exact.
Homography MapOf(const CameraPose& pose, const CameraIntrinsics& intrinsics, const GroundSurface& ground) {
  std::vector<Eigen::Vector2d> u, x;
  for (const double right : {0.0, 100.0, 255.0}) {
    for (const double down : {0.0, 80.0, 199.0}) {
      u.emplace_back(right, down);
      x.push_back(IntersectSurface(pose, intrinsics, ground, u.back())->head<2>());
    }
  }
  Homography map = *FitHomography(u, x);
  if (map.Depth(u[4]) < 0.0) map.matrix *= -1.0;
  return map;
}

// The views of frames [begin, end) of one ROI, and the scenes emitted on the way.
Segment MakeSegment(const SyntheticOptions& options, const SyntheticSortie& sortie, const Homography& world_from_scene, const Roi& roi,
                    int begin, int end, double gain, double offset, Rng& rng) {
  Segment segment;
  segment.roi_in_sensor = roi;
  const auto corners = RoiCorners(roi);
  const auto points = TiePoints(roi);
  const double variance = std::max(1e-8, options.view_sigma_px * options.view_sigma_px);
  for (int t = begin; t < end; ++t) {
    const auto frame = static_cast<std::size_t>(t);
    const Homography scene_from_sensor = world_from_scene.Inverse() * sortie.world_from_sensor[frame];
    std::vector<Eigen::Vector2d> x;
    for (const Eigen::Vector2d& u : points) x.push_back(scene_from_sensor * sortie.Undistorted(u, options.k1));
    // The estimate's sensor_from_scene is off by independent displacements of the upper left, upper right and lower left corner, and of
    // the lower right one when it is projective.
    std::vector<Eigen::Vector2d> own = {corners[0], corners[1], corners[3]};
    if (options.projective_views) own.push_back(corners[2]);
    std::vector<Eigen::Vector2d> displaced;
    for (const Eigen::Vector2d& u : own) displaced.push_back(u + options.view_sigma_px * Eigen::Vector2d(rng.Normal(), rng.Normal()));
    ChainView view;
    view.frame = static_cast<std::uint32_t>(t);
    if (!sortie.poses.empty()) {
      const Homography scene_from_first = world_from_scene.Inverse() * sortie.world_from_sensor[static_cast<std::size_t>(begin)];
      const CameraPose& first = sortie.poses[static_cast<std::size_t>(begin)];
      view.scene_from_sensor = ViewOverHills(sortie, scene_from_first, sortie.poses[frame], first, roi) * *FitAffine(displaced, own);
    } else if (options.projective_views) {
      view.scene_from_sensor = PlanarMap::FromHomography(scene_from_sensor * *FitHomography(displaced, own));
    } else {
      view.scene_from_sensor = *FitAffine(points, x) * *FitAffine(displaced, own);
    }
    const auto parameters = static_cast<Eigen::Index>(2 * own.size());
    view.corner_covariance_px2 = variance * CornerCovariance::Identity(parameters, parameters);
    view.gain = sortie.frame_gain[frame] / gain * std::exp(0.001 * rng.Normal());
    view.offset = sortie.frame_offset[frame] - view.gain * offset + 0.05 * rng.Normal();
    view.gain_offset_covariance << 1e-6, 0.0, 0.0, 2.5e-3;
    segment.chain.push_back(view);
  }
  for (int t = begin, id = 0; t < end; t += kEmitEvery, ++id) {
    Scene scene;
    scene.scene_id = static_cast<std::uint32_t>(id);
    scene.frame_begin = static_cast<std::uint32_t>(t);
    scene.frame_end = static_cast<std::uint32_t>(std::min(end, t + kEmitEvery));
    const PlanarMap& middle =
        segment.chain[static_cast<std::size_t>((scene.frame_begin + scene.frame_end) / 2 - static_cast<std::uint32_t>(begin))]
            .scene_from_sensor;
    Eigen::Vector2d low = middle * corners[0], high = low;
    for (const Eigen::Vector2d& u : corners) {
      low = low.cwiseMin(middle * u);
      high = high.cwiseMax(middle * u);
    }
    scene.roi_in_scene = {static_cast<int>(std::floor(low.x())), static_cast<int>(std::floor(low.y())),
                          static_cast<int>(std::ceil(high.x())) + 1, static_cast<int>(std::ceil(high.y())) + 1};
    segment.scenes.push_back(scene);
  }
  return segment;
}

}  // namespace

Eigen::Vector2d SyntheticSortie::Distorted(const Eigen::Vector2d& u, double k1) const {
  const Eigen::Vector2d centre(0.5 * (kWidth - 1), 0.5 * (kHeight - 1));
  const Eigen::Vector2d ray = (u - centre) / focal_px;
  return centre + focal_px * (1.0 + k1 * ray.squaredNorm()) * ray;
}

Eigen::Vector2d SyntheticSortie::Undistorted(const Eigen::Vector2d& u, double k1) const {
  Eigen::Vector2d pinhole = u;
  for (int i = 0; i < 30; ++i) pinhole += u - Distorted(pinhole, k1);
  return pinhole;
}

Eigen::Vector2d SyntheticSortie::PlaceOfCell(std::size_t segment, const Eigen::Vector2d& c) const {
  const auto first = static_cast<std::size_t>(first_frame[segment]);
  const Eigen::Vector2d u = world_from_sensor[first].Inverse() * (world_from_scene[segment] * c);
  return IntersectSurface(poses[first], {kWidth, kHeight, focal_px}, *input.ground, u)->head<2>();
}

std::vector<ControlObservation> ObserveControl(const SyntheticOptions& options, const SyntheticSortie& sortie, const std::string& name,
                                               const Eigen::Vector2d& place, double sigma_px) {
  std::vector<ControlObservation> observations;
  Rng rng({options.seed, 3, std::hash<std::string>{}(name)});
  const double z = sortie.input.ground ? *sortie.input.ground->ElevationAt(place) : 0.0;
  for (std::size_t t = 0; t < sortie.world_from_sensor.size(); t += 3) {
    const Homography sensor_from_world = sortie.world_from_sensor[t].Inverse();
    const Eigen::Vector2d u = sortie.Distorted(sensor_from_world * place, options.k1);
    if (u.x() < 5.0 || u.y() < 5.0 || u.x() > kWidth - 5.0 || u.y() > kHeight - 5.0) continue;
    const Eigen::Vector2d noise(rng.Normal(), rng.Normal());
    observations.push_back({name, static_cast<std::uint32_t>(t), u + sigma_px * noise, {place.x(), place.y(), z}, false});
  }
  return observations;
}

std::vector<ControlObservation> FourPoints(const SyntheticOptions& options, const SyntheticSortie& sortie) {
  std::vector<ControlObservation> control;
  const Eigen::Vector2d first = sortie.world_from_sensor.front() * Eigen::Vector2d(128.0, 100.0);
  const Eigen::Vector2d last = sortie.world_from_sensor.back() * Eigen::Vector2d(128.0, 100.0);
  int number = 0;
  for (const Eigen::Vector2d& centre : {first, last}) {
    for (const double side : {-1.0, 1.0}) {
      const Eigen::Vector2d place = centre + side * 60.0 * sortie.gsd_m * Eigen::Vector2d(0.3, 1.0);
      const auto seen = ObserveControl(options, sortie, "P" + std::to_string(++number), place, 0.2);
      control.insert(control.end(), seen.begin(), seen.end());
    }
  }
  return control;
}

SyntheticSortie MakeSortie(const SyntheticOptions& options) {
  SyntheticSortie sortie;
  AlignInput& input = sortie.input;
  input.width_px = kWidth;
  input.height_px = kHeight;
  input.ratio = 3;
  input.position_sigma_m = std::max(0.05, options.position_bias_m);
  input.attitude_sigma_rad = std::max(0.005, std::max(options.attitude_bias_deg, options.attitude_white_deg)) * kRad;
  const CameraIntrinsics intrinsics{kWidth, kHeight, FocalFromHorizontalFov(kWidth, options.hfov_deg * kRad)};
  sortie.gsd_m = kAltitudeM / intrinsics.focal_px;
  sortie.focal_px = intrinsics.focal_px;
  if (options.slope != 0.0) input.ground = Slope(options.slope);
  if (options.hills_m != 0.0) input.ground = Hills(options.hills_m);

  std::vector<CameraPose> poses;
  Rng rng({options.seed, 1});
  for (int t = 0; t < options.frame_count; ++t) {
    poses.push_back(TruePose(options, t, 0.5 * kHeight * sortie.gsd_m, rng));
    sortie.world_from_sensor.push_back(input.ground ? MapOf(poses.back(), intrinsics, *input.ground)
                                                    : GroundFromSensor(poses.back(), intrinsics, 0.0));
    sortie.frame_gain.push_back(std::exp(options.gain_sigma * rng.Normal()));
    sortie.frame_offset.push_back(options.offset_sigma * rng.Normal());
  }
  if (options.hills_m != 0.0) sortie.poses = poses;
  if (options.telemetry) AddAnchors(options, poses, intrinsics.focal_px, sortie);

  const std::vector<Roi> rois = {{0, 0, 141, 111}, {115, 0, 256, 111}, {0, 89, 141, 200}, {115, 89, 256, 200}};
  std::vector<std::pair<int, int>> spans = {{0, options.frame_count}};
  if (options.gap_after_frame >= 0) spans = {{0, options.gap_after_frame + 1}, {options.gap_after_frame + 1, options.frame_count}};
  std::uint32_t window_id = 0;
  for (const auto& [span_begin, span_end] : spans) {
    for (int begin = span_begin; begin < span_end; begin += kWindowFrames - kWindowOverlap) {
      const int end = std::min(span_end, begin + kWindowFrames);
      for (const Roi& roi : rois) {
        Homography sensor_from_scene;
        sensor_from_scene.matrix << 1.0 / 3.0, 0.0, roi.x0, 0.0, 1.0 / 3.0, roi.y0, 0.0, 0.0, 1.0;
        const auto first = static_cast<std::size_t>(begin);
        const Homography world_from_scene = sortie.world_from_sensor[first] * sensor_from_scene;
        Segment segment =
            MakeSegment(options, sortie, world_from_scene, roi, begin, end, sortie.frame_gain[first], sortie.frame_offset[first], rng);
        segment.window_id = window_id++;
        input.segments.push_back(std::move(segment));
        sortie.world_from_scene.push_back(world_from_scene);
        sortie.first_frame.push_back(begin);
        sortie.scene_gain.push_back(sortie.frame_gain[first]);
        sortie.scene_offset.push_back(sortie.frame_offset[first]);
      }
      if (end == span_end) break;
    }
  }
  return sortie;
}

}  // namespace trem::align
