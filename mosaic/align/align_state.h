#pragma once

#include <Eigen/Core>
#include <map>
#include <optional>
#include <span>
#include <vector>

#include "mosaic/align/align_graph.h"
#include "mosaic/geometry/cell_grid.h"

namespace trem::align {

// What all cameras of a sortie share. A ray (x, y, 1) in camera axes is seen at
//
//   centre + focal_px exp(log_focal) (1 + k1 (x^2 + y^2)) (x, y)
struct Lens {
  double log_focal = 0.0;  // What telemetry's focal lengths are off by.
  double k1 = 0.0;         // Radial distortion; positive: pincushion.

  bool IsPinhole() const { return k1 == 0.0; }
};

// A camera in the working world; see geometry/camera.h for its axes.
struct Camera {
  Eigen::Vector3d position_m = Eigen::Vector3d::Zero();
  Eigen::Matrix3d world_from_camera = Eigen::Matrix3d::Identity();
  double focal_px = 1.0;
};

Camera CameraFromAnchor(const FrameAnchor& anchor);
// world_from_sensor on the ground; Depth() > 0 below the horizon. Over a surface that is not level, or with a lens that distorts, the
// planar map that fits rays through the image best.
Homography GroundFromCamera(const Camera& camera, const Lens& lens, const AlignInput& input);
// Where the ray of sensor pixel `u` meets the ground; nothing when it does not.
std::optional<Eigen::Vector3d> MeetGround(const Camera& camera, const Lens& lens, const AlignInput& input, const Eigen::Vector2d& u);
// The sensor pixel that sees the place; nothing behind the camera.
std::optional<Eigen::Vector2d> PixelOf(const Camera& camera, const Lens& lens, const AlignInput& input, const Eigen::Vector3d& x_in_world);

struct FrameState {
  std::optional<Camera> camera;  // Frames with a pose: the map follows from it.
  Homography world_from_sensor;  // Of the others it is free.
  double log_scale0 = 0.0;       // Without telemetry: log of the linear scale at the image centre that the chain suggests.
  int piece = -1;                // -1: not placed.
  bool gauge = false;            // Held fixed: the reference of a piece without telemetry.
};

struct SceneState {
  Homography world_from_scene;
  CellShifts shifts;  // What relief adds to it; see relief.h.
  int piece = -1;
};

// Where a scene shows a place of the world, undone: Unshifted, then world_from_scene.
Eigen::Vector2d WorldFromShown(const SceneState& scene, const Eigen::Vector2d& shown);

// True = telemetry + bias: metres, and radians about the camera's axes.
struct TelemetryBias {
  Eigen::Vector3d position_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d attitude_rad = Eigen::Vector3d::Zero();
};

// Current values of all unknowns, parallel to AlignGraph::frames and ::scenes.
struct AlignState {
  std::vector<FrameState> frames;
  std::vector<SceneState> scenes;
  std::vector<bool> piece_anchored;  // A piece whose frames include one with telemetry.
  // Shared errors of each recording's telemetry; absent: zero.
  std::map<std::uint32_t, TelemetryBias> biases;
  Lens lens;
  // Ties that were left out because the ROI reaches the horizon in that frame.
  std::vector<bool> tie_unusable;
  // What relief adds to each tie's floor (Tie::floor_px), sensor px; see relief.h.
  std::vector<double> tie_relief_px;
};

// Initial values: frames with telemetry from it, everything else breadth first over the graph of ties; in each connected component
// ("piece") without telemetry the middle frame is the reference, with x right and y up. Maps found along the chain are affine.
AlignState InitialState(const AlignGraph& graph);

// Joins pieces that content ties connect: the piece that is not anchored (of two such: the one with the higher number) is moved onto the
// other by the similarity that fits the tie's points best. Pieces are renumbered 0, 1, ... in order of their first frame.
// Returns the number of joins.
int JoinPieces(const AlignGraph& graph, std::span<const ContentTie> ties, AlignState& state);

// Whether all four corners of the view's ROI see the ground at less than 20 times the distance per pixel of its centre.
bool RoiSeesGround(const Homography& world_from_sensor, const Roi& roi_in_sensor);

}  // namespace trem::align
