#include "mosaic/align/align_state.h"

#include <algorithm>
#include <cmath>
#include <complex>
#include <deque>
#include <map>

#include "mosaic/base/check.h"

namespace trem::align {
namespace {

// Sensor points (x right, y down) to the working world (y up), with the image centre at 0.
Homography UprightWorldFromSensor(const AlignInput& input) {
  Homography h;
  h.matrix << 1.0, 0.0, -0.5 * (input.width_px - 1), 0.0, -1.0, 0.5 * (input.height_px - 1), 0.0, 0.0, 1.0;
  return h;
}

Homography FromCorners(const FrameAnchor& anchor, const AlignInput& input) {
  const double right = input.width_px - 0.5;
  const double bottom = input.height_px - 0.5;
  const std::array<Eigen::Vector2d, 4> u = {Eigen::Vector2d(-0.5, -0.5), Eigen::Vector2d(right, -0.5), Eigen::Vector2d(right, bottom),
                                            Eigen::Vector2d(-0.5, bottom)};
  const Result<Homography> fit = FitHomography(u, *anchor.corners);
  if (fit.ok()) return *fit;
  const Result<Affine> affine = FitAffine(u, *anchor.corners);
  return affine.ok() ? Homography::FromAffine(*affine) : Homography{Eigen::Matrix3d::Zero()};
}

// Components of the graph of usable ties, as one number per frame and scene (frames first), numbered by their first frame.
std::vector<int> Components(const AlignGraph& graph, const std::vector<bool>& tie_unusable, int* count) {
  const int frame_count = static_cast<int>(graph.frames.size());
  std::vector<int> component(graph.frames.size() + graph.scenes.size(), -1);
  *count = 0;
  for (int start = 0; start < frame_count; ++start) {
    if (component[static_cast<std::size_t>(start)] >= 0) continue;
    std::deque<int> queue = {start};
    component[static_cast<std::size_t>(start)] = *count;
    while (!queue.empty()) {
      const int node = queue.front();
      queue.pop_front();
      const bool is_frame = node < frame_count;
      const auto& ties =
          is_frame ? graph.frames[static_cast<std::size_t>(node)].ties : graph.scenes[static_cast<std::size_t>(node - frame_count)].ties;
      for (const int t : ties) {
        if (tie_unusable[static_cast<std::size_t>(t)]) continue;
        const Tie& tie = graph.ties[static_cast<std::size_t>(t)];
        const int other = is_frame ? frame_count + tie.scene : tie.frame;
        if (component[static_cast<std::size_t>(other)] >= 0) continue;
        component[static_cast<std::size_t>(other)] = *count;
        queue.push_back(other);
      }
    }
    ++*count;
  }
  return component;
}

void SpreadFrom(const AlignGraph& graph, std::deque<int> frames, AlignState& state) {
  while (!frames.empty()) {
    const int f = frames.front();
    frames.pop_front();
    const FrameState frame = state.frames[static_cast<std::size_t>(f)];
    for (const int t : graph.frames[static_cast<std::size_t>(f)].ties) {
      const Tie& tie = graph.ties[static_cast<std::size_t>(t)];
      SceneState& scene = state.scenes[static_cast<std::size_t>(tie.scene)];
      if (state.tie_unusable[static_cast<std::size_t>(t)] || scene.piece >= 0) continue;
      scene.world_from_scene = frame.world_from_sensor * graph.ViewOf(tie).scene_from_sensor.ToHomography().Inverse();
      scene.piece = frame.piece;
      for (const int back : graph.scenes[static_cast<std::size_t>(tie.scene)].ties) {
        const Tie& other = graph.ties[static_cast<std::size_t>(back)];
        FrameState& next = state.frames[static_cast<std::size_t>(other.frame)];
        if (state.tie_unusable[static_cast<std::size_t>(back)] || next.piece >= 0) continue;
        next.world_from_sensor = scene.world_from_scene * graph.ViewOf(other).scene_from_sensor.ToHomography();
        next.piece = scene.piece;
        frames.push_back(other.frame);
      }
    }
  }
}

double LogScaleAtCentre(const Homography& world_from_sensor, const AlignInput& input) {
  const Eigen::Vector2d centre(0.5 * (input.width_px - 1), 0.5 * (input.height_px - 1));
  return 0.5 * std::log(std::abs(world_from_sensor.LinearisedAt(centre).linear.determinant()));
}

// The similarity w -> a w + b (as complex numbers) that fits pairs of world points best.
struct Similarity {
  std::complex<double> a = 1.0;
  std::complex<double> b = 0.0;
  Homography ToHomography() const {
    Homography h;
    h.matrix << a.real(), -a.imag(), b.real(), a.imag(), a.real(), b.imag(), 0.0, 0.0, 1.0;
    return h;
  }
};

Similarity FitSimilarity(const std::vector<Eigen::Vector2d>& from, const std::vector<Eigen::Vector2d>& to) {
  Eigen::Vector2d from_mean = Eigen::Vector2d::Zero();
  Eigen::Vector2d to_mean = Eigen::Vector2d::Zero();
  for (std::size_t i = 0; i < from.size(); ++i) {
    from_mean += from[i] / static_cast<double>(from.size());
    to_mean += to[i] / static_cast<double>(from.size());
  }
  std::complex<double> cross = 0.0;
  double norm = 0.0;
  for (std::size_t i = 0; i < from.size(); ++i) {
    const std::complex<double> x(from[i].x() - from_mean.x(), from[i].y() - from_mean.y());
    const std::complex<double> y(to[i].x() - to_mean.x(), to[i].y() - to_mean.y());
    cross += y * std::conj(x);
    norm += std::norm(x);
  }
  Similarity s;
  if (norm > 0.0 && std::abs(cross) > 0.0) s.a = cross / norm;
  s.b = std::complex<double>(to_mean.x(), to_mean.y()) - s.a * std::complex<double>(from_mean.x(), from_mean.y());
  return s;
}

void MovePiece(int piece, int onto, const Similarity& similarity, AlignState& state) {
  const Homography onto_from_piece = similarity.ToHomography();
  for (FrameState& frame : state.frames) {
    if (frame.piece != piece) continue;
    frame.world_from_sensor = onto_from_piece * frame.world_from_sensor;
    frame.log_scale0 += std::log(std::abs(similarity.a));
    frame.piece = onto;
    frame.gauge = false;
  }
  for (SceneState& scene : state.scenes) {
    if (scene.piece != piece) continue;
    scene.world_from_scene = onto_from_piece * scene.world_from_scene;
    scene.piece = onto;
  }
}

void RenumberPieces(AlignState& state) {
  std::map<int, int> number;
  const auto renumber = [&](int& piece) {
    if (piece >= 0) piece = number.emplace(piece, static_cast<int>(number.size())).first->second;
  };
  for (FrameState& frame : state.frames) renumber(frame.piece);
  for (SceneState& scene : state.scenes) renumber(scene.piece);
  std::vector<bool> anchored(number.size());
  for (const auto& [old_piece, new_piece] : number) {
    anchored[static_cast<std::size_t>(new_piece)] = state.piece_anchored[static_cast<std::size_t>(old_piece)];
  }
  state.piece_anchored = anchored;
}

void PlaceAnchored(const AlignGraph& graph, AlignState& state) {
  for (std::size_t f = 0; f < graph.frames.size(); ++f) {
    if (graph.frames[f].anchor < 0) continue;
    const FrameAnchor& anchor = graph.input.anchors[static_cast<std::size_t>(graph.frames[f].anchor)];
    FrameState& frame = state.frames[f];
    if (anchor.pose) {
      frame.camera = CameraFromAnchor(anchor);
      frame.world_from_sensor = GroundFromCamera(*frame.camera, state.lens, graph.input);
    } else {
      frame.world_from_sensor = FromCorners(anchor, graph.input);
    }
    for (const int t : graph.frames[f].ties) {
      const Roi& roi = graph.SegmentOf(graph.ties[static_cast<std::size_t>(t)]).roi_in_sensor;
      state.tie_unusable[static_cast<std::size_t>(t)] = !RoiSeesGround(frame.world_from_sensor, roi);
    }
  }
}

// The planar map that fits a grid of rays best; nothing when one of them misses the ground.
std::optional<Homography> FittedGround(const Camera& camera, const Lens& lens, const AlignInput& input) {
  constexpr int kSide = 5;
  std::vector<Eigen::Vector2d> pixels;
  std::vector<Eigen::Vector2d> places;
  for (int j = 0; j < kSide; ++j) {
    for (int i = 0; i < kSide; ++i) {
      const Eigen::Vector2d u(i * (input.width_px - 1.0) / (kSide - 1), j * (input.height_px - 1.0) / (kSide - 1));
      const std::optional<Eigen::Vector3d> place = MeetGround(camera, lens, input, u);
      if (!place) return std::nullopt;
      pixels.push_back(u);
      places.push_back(place->head<2>());
    }
  }
  Result<Homography> fit = FitHomography(pixels, places);
  if (!fit.ok()) return std::nullopt;
  // Visible, so of positive depth.
  if (fit->Depth(pixels[pixels.size() / 2]) < 0.0) fit->matrix *= -1.0;
  return *fit;
}

}  // namespace

Camera CameraFromAnchor(const FrameAnchor& anchor) {
  return {anchor.pose->position_m, WorldFromCamera(anchor.pose->yaw_rad, anchor.pose->pitch_rad, anchor.pose->roll_rad), anchor.focal_px};
}

std::optional<Eigen::Vector3d> MeetGround(const Camera& camera, const Lens& lens, const AlignInput& input, const Eigen::Vector2d& u) {
  const double focal_px = camera.focal_px * std::exp(lens.log_focal);
  const Eigen::Vector2d seen(u.x() - 0.5 * (input.width_px - 1), u.y() - 0.5 * (input.height_px - 1));
  // Undone by fixed point: distortions of lenses are a few per cent.
  constexpr int kIterations = 20;
  Eigen::Vector2d ray = seen / focal_px;
  for (int i = 0; i < kIterations && !lens.IsPinhole(); ++i) ray = seen / (focal_px * (1.0 + lens.k1 * ray.squaredNorm()));
  const Eigen::Vector3d direction = camera.world_from_camera * ray.homogeneous();
  if (input.ground) return IntersectSurface(camera.position_m, direction, *input.ground);
  return IntersectSurface(camera.position_m, direction, LevelGround(input.ground_z_m));
}

std::optional<Eigen::Vector2d> PixelOf(const Camera& camera, const Lens& lens, const AlignInput& input, const Eigen::Vector3d& x_in_world) {
  const Eigen::Vector3d ray = camera.world_from_camera.transpose() * (x_in_world - camera.position_m);
  if (!(ray.z() > 1e-6)) return std::nullopt;
  const Eigen::Vector2d direction = ray.head<2>() / ray.z();
  const double focal_px = camera.focal_px * std::exp(lens.log_focal) * (1.0 + lens.k1 * direction.squaredNorm());
  return Eigen::Vector2d(0.5 * (input.width_px - 1), 0.5 * (input.height_px - 1)) + focal_px * direction;
}

Eigen::Vector2d WorldFromShown(const SceneState& scene, const Eigen::Vector2d& shown) {
  return scene.world_from_scene * Unshifted(scene.shifts, shown);
}

Homography GroundFromCamera(const Camera& camera, const Lens& lens, const AlignInput& input) {
  if (!lens.IsPinhole() || (input.ground && input.ground->spacing() > 0.0)) {
    const std::optional<Homography> fitted = FittedGround(camera, lens, input);
    if (fitted) return *fitted;
  }
  const double focal_px = camera.focal_px * std::exp(lens.log_focal);
  Eigen::Matrix3d camera_from_sensor;
  camera_from_sensor << 1.0 / focal_px, 0.0, -0.5 * (input.width_px - 1) / focal_px, 0.0, 1.0 / focal_px,
      -0.5 * (input.height_px - 1) / focal_px, 0.0, 0.0, 1.0;
  // As geometry's GroundFromSensor, of a rotation matrix instead of angles (which are degenerate straight down).
  const Eigen::Matrix3d direction = camera.world_from_camera * camera_from_sensor;
  const double height_m =
      camera.position_m.z() - (input.ground ? 0.5 * (input.ground->lowest_m() + input.ground->highest_m()) : input.ground_z_m);
  Homography ground_from_sensor;
  ground_from_sensor.matrix.row(2) = -direction.row(2);
  ground_from_sensor.matrix.row(0) = height_m * direction.row(0) - camera.position_m.x() * direction.row(2);
  ground_from_sensor.matrix.row(1) = height_m * direction.row(1) - camera.position_m.y() * direction.row(2);
  return ground_from_sensor;
}

bool RoiSeesGround(const Homography& world_from_sensor, const Roi& roi) {
  const Eigen::Vector2d centre(0.5 * (roi.x0 + roi.x1 - 1), 0.5 * (roi.y0 + roi.y1 - 1));
  const double depth_at_centre = world_from_sensor.Depth(centre);
  if (!(depth_at_centre > 0.0) || !(std::abs(world_from_sensor.matrix.determinant()) > 0.0)) return false;
  const auto corners = RoiCorners(roi);
  return std::all_of(corners.begin(), corners.end(),
                     [&](const Eigen::Vector2d& u) { return world_from_sensor.Depth(u) > 0.05 * depth_at_centre; });
}

AlignState InitialState(const AlignGraph& graph) {
  AlignState state;
  state.frames.resize(graph.frames.size());
  state.scenes.resize(graph.scenes.size());
  state.tie_unusable.assign(graph.ties.size(), false);
  state.tie_relief_px.assign(graph.ties.size(), 0.0);
  PlaceAnchored(graph, state);

  int piece_count = 0;
  const std::vector<int> component = Components(graph, state.tie_unusable, &piece_count);
  state.piece_anchored.assign(static_cast<std::size_t>(piece_count), false);
  for (int piece = 0; piece < piece_count; ++piece) {
    std::deque<int> anchored;
    std::vector<int> members;
    for (std::size_t f = 0; f < graph.frames.size(); ++f) {
      if (component[f] != piece) continue;
      members.push_back(static_cast<int>(f));
      if (graph.frames[f].anchor < 0) continue;
      state.frames[f].piece = piece;
      anchored.push_back(static_cast<int>(f));
    }
    state.piece_anchored[static_cast<std::size_t>(piece)] = !anchored.empty();
    if (anchored.empty()) {
      const int reference = members[members.size() / 2];
      FrameState& frame = state.frames[static_cast<std::size_t>(reference)];
      frame.world_from_sensor = UprightWorldFromSensor(graph.input);
      frame.piece = piece;
      frame.gauge = true;
      anchored.push_back(reference);
    }
    SpreadFrom(graph, anchored, state);
  }
  for (FrameState& frame : state.frames) {
    if (frame.piece >= 0) frame.log_scale0 = LogScaleAtCentre(frame.world_from_sensor, graph.input);
  }
  return state;
}

int JoinPieces(const AlignGraph& graph, std::span<const ContentTie> ties, AlignState& state) {
  TREM_CHECK(graph.scenes.size() == state.scenes.size());
  int joined = 0;
  for (const ContentTie& tie : ties) {
    const SceneState a = state.scenes[static_cast<std::size_t>(tie.scene_a)];
    const SceneState b = state.scenes[static_cast<std::size_t>(tie.scene_b)];
    if (a.piece < 0 || b.piece < 0 || a.piece == b.piece) continue;
    const bool a_anchored = state.piece_anchored[static_cast<std::size_t>(a.piece)];
    const bool b_anchored = state.piece_anchored[static_cast<std::size_t>(b.piece)];
    ++joined;
    if (a_anchored && b_anchored) {  // Telemetry has placed both already.
      MovePiece(std::max(a.piece, b.piece), std::min(a.piece, b.piece), {}, state);
      continue;
    }
    std::vector<Eigen::Vector2d> world_a;
    std::vector<Eigen::Vector2d> world_b;
    for (std::size_t i = 0; i < tie.x_in_a.size(); ++i) {
      world_a.push_back(WorldFromShown(a, tie.x_in_a[i]));
      world_b.push_back(WorldFromShown(b, tie.x_in_b[i]));
    }
    const bool move_b = a_anchored || (!b_anchored && a.piece < b.piece);
    if (move_b) {
      MovePiece(b.piece, a.piece, FitSimilarity(world_b, world_a), state);
    } else {
      MovePiece(a.piece, b.piece, FitSimilarity(world_a, world_b), state);
    }
  }
  if (joined > 0) RenumberPieces(state);
  return joined;
}

}  // namespace trem::align
