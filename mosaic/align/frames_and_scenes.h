#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "mosaic/geometry/affine.h"
#include "mosaic/geometry/camera.h"
#include "mosaic/geometry/ground_surface.h"
#include "mosaic/geometry/homography.h"
#include "mosaic/geometry/planar_map.h"
#include "mosaic/geometry/roi.h"

// What the alignment is given and what it finds.
//
// Unknowns: a map world_from_sensor of every used frame t and a map world_from_scene of every emitted scene i. Data: the chain views
// scene_from_sensor with their covariances, anchors (telemetry) of frames, and ties of content between scenes.
//
// The working world is a right-handed metric frame: x east, y north on the target map's grid, true metres (map units divided by the
// projection's scale factor), z up. Without telemetry it is in pixels of a reference frame's sensor: x right, y up.
namespace trem::align {

using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix6d = Eigen::Matrix<double, 6, 6>;
// 6 x 6 of an affine view or 8 x 8 of a projective one.
using CornerCovariance = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 8, 8>;

// One frame's view in a segment's chain.
struct ChainView {
  std::uint32_t frame = 0;
  PlanarMap scene_from_sensor;  // Cells of the segment's scene plane from sensor pixels.
  // Covariance of the positions of the ROI's upper left, upper right and lower left pixel as sensor-pixel displacements
  // (ul.x, ul.y, ur.x, ur.y, ll.x, ll.y), px^2. Projective views have (lr.x, lr.y), the lower right pixel, as well.
  CornerCovariance corner_covariance_px2 = Matrix6d::Zero();
  // frame = gain * scene + offset, internal grey levels.
  double gain = 1.0;
  double offset = 0.0;
  Eigen::Matrix2d gain_offset_covariance = Eigen::Matrix2d::Zero();
};

// An emitted scene: cells `roi_in_scene` of its segment's plane, dominated by the frames [frame_begin, frame_end).
struct Scene {
  std::uint32_t scene_id = 0;  // Within the window.
  Roi roi_in_scene;
  std::uint32_t frame_begin = 0;
  std::uint32_t frame_end = 0;
};

struct Segment {
  std::uint32_t window_id = 0;
  std::uint32_t segment_id = 0;
  Roi roi_in_sensor;
  std::vector<ChainView> chain;
  std::vector<Scene> scenes;
};

// What telemetry says of one frame, in the working world. Either a pose or the ground positions of the image's outer corners.
struct FrameAnchor {
  std::uint32_t frame = 0;
  std::optional<CameraPose> pose;  // Yaw from grid north.
  double focal_px = 0.0;           // With a pose.
  // Upper left, upper right, lower right, lower left: outer corners of the image, that is sensor points (-1/2, -1/2) and so on.
  std::optional<std::array<Eigen::Vector2d, 4>> corners = std::nullopt;
  // By how much this frame's pose is less sure than the others' (interpolated records): standard deviations, on top of AlignInput's.
  double position_extra_m = 0.0;
  double attitude_extra_rad = 0.0;
  std::uint32_t recording = 0;  // Anchors of one recording share one error.
};

// Points that two scenes have in common, in cells of their segments' planes.
struct ContentTie {
  int scene_a = 0;  // Index into AlignGraph::scenes.
  int scene_b = 0;
  std::vector<Eigen::Vector2d> x_in_a;
  std::vector<Eigen::Vector2d> x_in_b;
};

// A surveyed point that one frame shows.
struct ControlObservation {
  std::string name;  // Several observations of one point share it.
  std::uint32_t frame = 0;
  Eigen::Vector2d u = Eigen::Vector2d::Zero();           // Sensor pixels.
  Eigen::Vector3d x_in_world = Eigen::Vector3d::Zero();  // Working world.
  bool held_out = false;                                 // Compared with the result only.
};

// When the error of attitude that all frames share is an unknown instead of 0.
enum class Boresight {
  kWhereSeen,  // Where ground control, or legs of different headings that content ties join, show it.
  kEstimated,
  kHeld
};

// Standard deviations of one recording's telemetry.
struct TelemetrySigmas {
  double position_m = 1.0;
  double attitude_rad = 0.1 * 0.017453292519943295;
};

struct AlignInput {
  int width_px = 0;  // Of the sensor.
  int height_px = 0;
  int ratio = 3;  // Scene cells per sensor pixel.
  double ground_z_m = 0.0;
  std::shared_ptr<const GroundSurface> ground;  // In the working world; null: level at ground_z_m.
  double position_sigma_m = 1.0;
  double attitude_sigma_rad = 0.1 * 0.017453292519943295;
  // The same of single recordings, where they are others.
  std::map<std::uint32_t, TelemetrySigmas> recordings = {};
  std::vector<Segment> segments;
  std::vector<FrameAnchor> anchors;  // At most one a frame; empty: no telemetry.
  std::vector<ControlObservation> control;
  double control_sigma_px = 0.5;  // Of an observation's pixel, each axis.
  double control_sigma_m = 0.1;   // Of a point's survey, each axis.
  // Of the field of view that telemetry gives, relative, one error for all frames; 0: it is exact.
  double focal_sigma = 0.0;
  Boresight boresight = Boresight::kWhereSeen;
  bool estimate_distortion = false;  // Radial distortion of the lens, one coefficient.

  TelemetrySigmas SigmasOf(std::uint32_t recording) const {
    const auto found = recordings.find(recording);
    return found != recordings.end() ? found->second : TelemetrySigmas{position_sigma_m, attitude_sigma_rad};
  }
};

struct AlignOptions {
  // Frames that become unknowns. More: slower, and better averaged; all the others are placed by the scenes they belong to. One global
  // stride thins them, at most `stride_max` so that windows keep shared frames.
  int frames_max = 400;
  int stride_max = 8;
  // Frames a scene keeps at least, where it has them.
  int frames_per_scene_min = 3;
  // What an affine view leaves unexplained, sensor px: added to every chain view's covariance. Raise it for strong relief.
  double tie_floor_px = 0.05;
  // The same for frames next to those that dominate a scene, which see more of the chain's drift.
  double neighbour_floor_px = 0.10;
  // Standard deviation of a content tie's point, sensor px.
  double content_sigma_px = 0.6;
  // GPS errors are mostly common to a sortie: AlignInput::position_sigma_m is the sigma of one shared bias, and a frame deviates from
  // it by this fraction of it (at least `position_white_min_m`), so that metre-sized white noise does not bend what pixels measure.
  double position_white_fraction = 0.2;
  double position_white_min_m = 0.02;
  int iterations_max = 60;
  int threads = 1;  // That extract and match features; the result does not depend on it.
};

}  // namespace trem::align
