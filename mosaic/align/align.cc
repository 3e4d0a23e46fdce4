#include "mosaic/align/align.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <map>
#include <mutex>
#include <set>
#include <sstream>

#include "mosaic/align/align_state.h"
#include "mosaic/align/relief.h"
#include "mosaic/align/solver.h"
#include "mosaic/base/parallel.h"

namespace trem::align {
namespace {

// Squared whitened residual (8 degrees of freedom) above which a tie is an outlier: chance 5e-10 for a good one.
constexpr double kOutlierNorm2 = 60.0;
constexpr int kContentRounds = 3;

double ScaleAt(const Homography& h, const Eigen::Vector2d& x) { return std::sqrt(std::abs(h.LinearisedAt(x).linear.determinant())); }

Eigen::Vector2d CentreOf(const Roi& roi) { return {0.5 * (roi.x0 + roi.x1 - 1), 0.5 * (roi.y0 + roi.y1 - 1)}; }

// The features of the scenes that take part in content ties.
class ContentRounds {
 public:
  ContentRounds(const AlignGraph& graph, const FeatureSource& source, int threads) : graph_(graph), source_(source), threads_(threads) {}

  // `beside` is called once meanwhile: what does not depend on the features.
  Status Extract(const std::function<bool()>& progress, const std::function<Status()>& beside) {
    features_.resize(graph_.scenes.size());
    takes_part_.assign(graph_.scenes.size(), false);
    const std::size_t limit = static_cast<std::size_t>(options_.scenes_max);
    const std::size_t step = (graph_.scenes.size() + limit - 1) / limit;
    std::vector<std::size_t> scenes;
    for (std::size_t s = 0; s < graph_.scenes.size(); s += std::max<std::size_t>(1, step)) scenes.push_back(s);
    std::vector<Status> statuses(scenes.size());
    Status status_beside;
    ForEachIndex(threads_, static_cast<int>(scenes.size()) + 1, [&](int index, int) {
      if (index == 0) {
        status_beside = beside();
        return;
      }
      const auto k = static_cast<std::size_t>(index) - 1;
      if (!progress()) {
        statuses[k] = Cancelled("the alignment was stopped on request");
        return;
      }
      Result<SceneFeatures> features = source_(graph_, static_cast<int>(scenes[k]));
      statuses[k] = features.status();
      if (features.ok()) features_[scenes[k]] = std::move(*features);
    });
    TREM_RETURN_IF_ERROR(status_beside);
    for (std::size_t k = 0; k < scenes.size(); ++k) {
      TREM_RETURN_IF_ERROR(statuses[k]);
      takes_part_[scenes[k]] = static_cast<int>(features_[scenes[k]].x_in_scene.size()) >= options_.inliers_min;
    }
    return {};
  }

  // The scenes' mean levels, parallel to AlignGraph::scenes; once.
  std::vector<SceneLevels> TakeLevels() {
    std::vector<SceneLevels> levels;
    for (SceneFeatures& features : features_) levels.push_back(std::move(features.levels));
    return levels;
  }

  // Adds the ties of one round to `ties`; the number of new ones.
  Result<int> Find(const AlignState& state, const std::function<bool()>& progress, std::vector<ContentTie>& ties) {
    std::vector<std::pair<int, int>> pairs = CandidatePairs(graph_, state, takes_part_, options_);
    std::erase_if(pairs, [&](const std::pair<int, int>& pair) { return !tried_.insert(pair).second; });
    std::vector<std::optional<ContentTie>> matched(pairs.size());
    std::atomic<bool> is_stopped{false};
    ForEachIndex(threads_, static_cast<int>(pairs.size()), [&](int index, int) {
      const auto [a, b] = pairs[static_cast<std::size_t>(index)];
      if (is_stopped || !progress()) {
        is_stopped = true;
        return;
      }
      matched[static_cast<std::size_t>(index)] =
          MatchFeatures(a, features_[static_cast<std::size_t>(a)], b, features_[static_cast<std::size_t>(b)], graph_.input.ratio, options_);
    });
    if (is_stopped) return Cancelled("the alignment was stopped on request");
    int found = 0;
    for (std::optional<ContentTie>& tie : matched) {
      if (!tie || !Credible(*tie, state)) continue;
      ties.push_back(std::move(*tie));
      ++found;
    }
    return found;
  }

 private:
  // Between scenes of one piece, or of pieces that telemetry places, a tie may move things by a scene's size at most: drift is slower than
  // that, repeated texture is not.
  bool Credible(const ContentTie& tie, const AlignState& state) const {
    const auto a = static_cast<std::size_t>(tie.scene_a);
    const auto b = static_cast<std::size_t>(tie.scene_b);
    const auto anchored = [&](std::size_t s) { return state.piece_anchored[static_cast<std::size_t>(state.scenes[s].piece)]; };
    if (state.scenes[a].piece != state.scenes[b].piece && !(anchored(a) && anchored(b))) return true;
    Eigen::Vector2d shift = Eigen::Vector2d::Zero();
    for (std::size_t k = 0; k < tie.x_in_a.size(); ++k) {
      shift += (WorldFromShown(state.scenes[a], tie.x_in_a[k]) - WorldFromShown(state.scenes[b], tie.x_in_b[k])) /
               static_cast<double>(tie.x_in_a.size());
    }
    const Roi& roi = graph_.scenes[a].scene.roi_in_scene;
    return shift.norm() < std::max(roi.width(), roi.height()) * ScaleAt(state.scenes[a].world_from_scene, CentreOf(roi));
  }

  const AlignGraph& graph_;
  const FeatureSource& source_;
  const int threads_;
  ContentOptions options_;
  std::vector<SceneFeatures> features_;
  std::vector<bool> takes_part_;
  std::set<std::pair<int, int>> tried_;
};

bool AnyPieceAnchored(const AlignState& state) {
  return std::find(state.piece_anchored.begin(), state.piece_anchored.end(), true) != state.piece_anchored.end();
}

// Scenes into the solution, without those that nothing anchors or whose maps are not credible.
void CollectScenes(const AlignGraph& graph, const AlignState& state, const SolveReport& report, const PhotometricBalance& balance,
                   AlignSolution& solution) {
  std::vector<AlignedScene> placed;
  std::vector<double> areas;
  for (std::size_t s = 0; s < graph.scenes.size(); ++s) {
    const SceneNode& node = graph.scenes[s];
    AlignedScene scene;
    scene.window_id = node.window_id;
    scene.scene_id = node.scene.scene_id;
    scene.piece = state.scenes[s].piece;
    scene.world_from_scene = state.scenes[s].world_from_scene;
    scene.shifts = state.scenes[s].shifts;
    scene.shade = ShadeOf(graph, static_cast<int>(s), balance.vignetting);
    scene.position_sigma = report.scene_sigma.empty() ? 0.0 : report.scene_sigma[s];
    scene.balanced_from_scene = balance.balanced_from_scene[s];
    scene.roi_in_scene = node.scene.roi_in_scene;
    if (scene.piece < 0 || (solution.georeferenced && !state.piece_anchored[static_cast<std::size_t>(scene.piece)])) {
      solution.unplaced_scenes.push_back(scene);
      continue;
    }
    const double scale = ScaleAt(scene.world_from_scene, CentreOf(scene.roi_in_scene));
    areas.push_back(scale * scale);
    placed.push_back(scene);
  }
  if (placed.empty()) return;
  std::vector<double> sorted = areas;
  std::nth_element(sorted.begin(), sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2), sorted.end());
  const double median = sorted[sorted.size() / 2];
  for (std::size_t i = 0; i < placed.size(); ++i) {
    const double ratio = areas[i] / median;
    const bool sane =
        std::isfinite(ratio) && ratio < 8.0 && ratio > 1.0 / 8.0 && RoiSeesGround(placed[i].world_from_scene, placed[i].roi_in_scene);
    (sane ? solution.scenes : solution.insane_scenes).push_back(placed[i]);
  }
  const auto order = [](const AlignedScene& a, const AlignedScene& b) {
    return std::tie(a.window_id, a.scene_id) < std::tie(b.window_id, b.scene_id);
  };
  std::sort(solution.scenes.begin(), solution.scenes.end(), order);
}

struct FramePoints {
  std::vector<Eigen::Vector2d> u;
  std::vector<Eigen::Vector2d> x_in_world;
  Homography world_from_sensor;  // Of the last view.
  double log_gain_sum = 0.0;
  double offset_sum = 0.0;
  int views = 0;
  int piece = -1;
};

// Where the scenes that a chain feeds put each of its frames.
std::map<std::uint32_t, FramePoints> PointsOfFrames(const AlignGraph& graph, const AlignState& state, const PhotometricBalance& balance,
                                                    const std::set<int>& kept) {
  std::vector<std::vector<int>> scenes_of_segment(graph.input.segments.size());
  for (const int s : kept) scenes_of_segment[static_cast<std::size_t>(graph.scenes[static_cast<std::size_t>(s)].segment)].push_back(s);
  std::map<std::uint32_t, FramePoints> points;
  for (std::size_t g = 0; g < graph.input.segments.size(); ++g) {
    if (scenes_of_segment[g].empty()) continue;
    const Segment& segment = graph.input.segments[g];
    for (const ChainView& view : segment.chain) {
      const auto distance = [&](int s) {
        const Scene& scene = graph.scenes[static_cast<std::size_t>(s)].scene;
        return std::abs(2.0 * view.frame + 1.0 - scene.frame_begin - scene.frame_end);
      };
      const int nearest = *std::min_element(scenes_of_segment[g].begin(), scenes_of_segment[g].end(),
                                            [&](int a, int b) { return distance(a) < distance(b); });
      const auto s = static_cast<std::size_t>(nearest);
      FramePoints& frame = points[view.frame];
      if (frame.views > 0 && frame.piece != state.scenes[s].piece) continue;
      frame.piece = state.scenes[s].piece;
      frame.world_from_sensor = state.scenes[s].world_from_scene * view.scene_from_sensor.ToHomography();
      for (const Eigen::Vector2d& u : RoiCorners(segment.roi_in_sensor)) {
        frame.u.push_back(u);
        frame.x_in_world.push_back(WorldFromShown(state.scenes[s], view.scene_from_sensor * u));
      }
      // frame = g scene + o and balanced = a scene + b give frame = (g / a) balanced + (o - g b / a).
      const GainOffset& scene = balance.balanced_from_scene[s];
      if (view.gain > 1e-3) {
        frame.log_gain_sum += std::log(view.gain / scene.gain);
        frame.offset_sum += view.offset - view.gain / scene.gain * scene.offset;
      }
      ++frame.views;
    }
  }
  return points;
}

double RmsPx(const Homography& world_from_sensor, const FramePoints& points) {
  double sum = 0.0;
  for (std::size_t k = 0; k < points.u.size(); ++k) {
    const Affine local = world_from_sensor.LinearisedAt(points.u[k]);
    sum += (local.linear.inverse() * (points.x_in_world[k] - local * points.u[k])).squaredNorm();
  }
  return std::sqrt(sum / (2.0 * static_cast<double>(points.u.size())));
}

// The same by the rays of a camera, over ground of any shape.
double RmsPx(const Camera& camera, const Lens& lens, const AlignInput& input, const FramePoints& points) {
  double sum = 0.0, count = 0.0;
  for (std::size_t k = 0; k < points.u.size(); ++k) {
    const double z = input.ground ? input.ground->ElevationAt(points.x_in_world[k]).value_or(input.ground_z_m) : input.ground_z_m;
    const std::optional<Eigen::Vector2d> seen = PixelOf(camera, lens, input, {points.x_in_world[k].x(), points.x_in_world[k].y(), z});
    if (!seen) continue;
    sum += (*seen - points.u[k]).squaredNorm();
    count += 2.0;
  }
  return count > 0.0 ? std::sqrt(sum / count) : 0.0;
}

void CollectFrames(const AlignGraph& graph, const AlignState& state, const PhotometricBalance& balance, AlignSolution& solution) {
  std::set<std::pair<std::uint32_t, std::uint32_t>> kept_ids;
  for (const AlignedScene& scene : solution.scenes) kept_ids.insert({scene.window_id, scene.scene_id});
  std::set<int> kept;
  for (std::size_t s = 0; s < graph.scenes.size(); ++s) {
    if (kept_ids.count({graph.scenes[s].window_id, graph.scenes[s].scene.scene_id}) > 0) kept.insert(static_cast<int>(s));
  }
  std::map<std::uint32_t, std::size_t> unknown_of_frame;
  for (std::size_t f = 0; f < graph.frames.size(); ++f) unknown_of_frame[graph.frames[f].frame] = f;
  for (const auto& [index, points] : PointsOfFrames(graph, state, balance, kept)) {
    AlignedFrame frame;
    frame.frame = index;
    frame.piece = points.piece;
    frame.frame_from_balanced = {std::exp(points.log_gain_sum / points.views), points.offset_sum / points.views};
    frame.world_from_sensor = points.world_from_sensor;
    std::optional<Camera> camera;
    const auto unknown = unknown_of_frame.find(index);
    if (unknown != unknown_of_frame.end() && state.frames[unknown->second].piece == points.piece) {
      frame.world_from_sensor = state.frames[unknown->second].world_from_sensor;
      frame.frame_from_balanced = balance.frame_from_balanced[unknown->second];
      camera = state.frames[unknown->second].camera;
    } else if (points.u.size() >= 8) {
      const Result<Homography> fit = FitHomography(points.u, points.x_in_world);
      if (fit.ok() && fit->Depth({0.5 * (graph.input.width_px - 1), 0.5 * (graph.input.height_px - 1)}) > 0.0)
        frame.world_from_sensor = *fit;
    }
    frame.residual_px = camera ? RmsPx(*camera, state.lens, graph.input, points) : RmsPx(frame.world_from_sensor, points);
    solution.frames.push_back(frame);
  }
}

// Numbers the pieces that have scenes 0, 1, ... by their first frame, and lays them side by side when their places are arbitrary.
void LayOutPieces(const AlignGraph& graph, AlignSolution& solution) {
  std::map<int, int> number;
  for (const AlignedFrame& frame : solution.frames) number.emplace(frame.piece, static_cast<int>(number.size()));
  for (AlignedFrame& frame : solution.frames) frame.piece = number.at(frame.piece);
  for (AlignedScene& scene : solution.scenes) scene.piece = number.emplace(scene.piece, static_cast<int>(number.size())).first->second;
  solution.piece_count = static_cast<int>(number.size());
  if (solution.georeferenced || solution.piece_count < 2) return;
  const double gap = std::max(16.0, 0.1 * graph.input.width_px);
  double right = 0.0;
  for (int piece = 0; piece < solution.piece_count; ++piece) {
    Eigen::Vector2d low = Eigen::Vector2d::Constant(1e300);
    Eigen::Vector2d high = Eigen::Vector2d::Constant(-1e300);
    for (const AlignedScene& scene : solution.scenes) {
      if (scene.piece != piece) continue;
      for (const Eigen::Vector2d& corner : RoiCorners(scene.roi_in_scene)) {
        low = low.cwiseMin(scene.world_from_scene * corner);
        high = high.cwiseMax(scene.world_from_scene * corner);
      }
    }
    Homography moved;
    moved.matrix(0, 2) = right - low.x();
    moved.matrix(1, 2) = -high.y();
    right += high.x() - low.x() + gap;
    for (AlignedScene& scene : solution.scenes) {
      if (scene.piece == piece) scene.world_from_scene = moved * scene.world_from_scene;
    }
    for (AlignedFrame& frame : solution.frames) {
      if (frame.piece == piece) frame.world_from_sensor = moved * frame.world_from_sensor;
    }
  }
}

void CollectTies(const AlignGraph& graph, const AlignState& state, const SolveReport& report, AlignSolution& solution) {
  std::set<std::uint32_t> horizon;
  for (std::size_t t = 0; t < graph.ties.size(); ++t) {
    const Tie& tie = graph.ties[t];
    const std::uint32_t frame = graph.frames[static_cast<std::size_t>(tie.frame)].frame;
    if (state.tie_unusable[t]) horizon.insert(frame);
    if (report.tie_norm2[t] <= kOutlierNorm2) continue;
    const SceneNode& scene = graph.scenes[static_cast<std::size_t>(tie.scene)];
    solution.outlier_ties.push_back({frame, scene.window_id, scene.scene.scene_id, std::sqrt(report.tie_error2_px2[t])});
  }
  solution.horizon_frames.assign(horizon.begin(), horizon.end());
}

void CollectPairs(const AlignGraph& graph, const std::vector<ContentTie>& content, const SolveReport& report, AlignSolution& solution) {
  for (std::size_t t = 0; t < report.content_tie_outlier.size(); ++t) {
    if (!report.content_tie_outlier[t]) continue;
    const SceneNode& a = graph.scenes[static_cast<std::size_t>(content[t].scene_a)];
    const SceneNode& b = graph.scenes[static_cast<std::size_t>(content[t].scene_b)];
    solution.outlier_pairs.push_back({a.window_id, a.scene.scene_id, b.window_id, b.scene.scene_id, report.content_error_px[t]});
  }
}

std::string GaugeText(const AlignGraph& graph, const AlignOptions& options, const AlignState& state, const AlignSolution& solution) {
  std::ostringstream text;
  if (solution.georeferenced) {
    text << "telemetry: one shared error of position (sigma " << graph.input.position_sigma_m << " m) and attitude (sigma "
         << graph.input.attitude_sigma_rad * 57.29577951308232 << " deg), and a deviation of each frame from it (sigma "
         << std::max(options.position_white_min_m, options.position_white_fraction * graph.input.position_sigma_m) << " m); the ground is ";
    if (graph.input.ground && graph.input.ground->spacing() > 0.0) {
      text << "a surface between " << graph.input.ground->lowest_m() << " and " << graph.input.ground->highest_m() << " m";
    } else {
      text << "the plane at elevation " << graph.input.ground_z_m << " m";
    }
    if (solution.control.constraints.point_count > 0) text << "; " << solution.control.constraints.point_count << " ground control points";
    return text.str();
  }
  text << "no telemetry: x right, y up, in sensor pixels of frame";
  int references = 0;
  for (std::size_t f = 0; f < graph.frames.size(); ++f) {
    if (!state.frames[f].gauge) continue;
    if (references < 10) text << (references == 0 ? " " : ", ") << graph.frames[f].frame;
    ++references;
  }
  if (references > 10) text << " and " << references - 10 << " more";
  if (solution.piece_count > 1) text << " (one a piece); the pieces' relative placement, side by side from left to right, is arbitrary";
  return text.str();
}

}  // namespace

Result<AlignSolution> Align(AlignInput input, const AlignOptions& options, const FeatureSource& features, const AlignProgress& progress) {
  const AlignGraph graph = BuildAlignGraph(std::move(input), options);
  if (graph.scenes.empty()) return Failed("there is no enhanced scene to align");
  AlignSolution solution;
  double done = 0.0;
  std::mutex mutex;  // Threads report one at a time.
  const auto tick = [&] {
    const std::lock_guard lock(mutex);
    done = std::min(0.95, done + 0.002);
    return !progress || progress(done);
  };
  AlignState state = InitialState(graph);
  std::vector<ContentTie> content;
  // What relief shifts depends on where the cameras are, little enough for every solve to start from what the one before found.
  const auto solve = [&](bool with_sigma) {
    UpdateShifts(graph, Shifts::kRelief, state);
    return Solve(graph, content, options, with_sigma, tick, state);
  };
  const bool hilly = graph.input.ground && graph.input.ground->spacing() > 0.0;
  if (!features && hilly) TREM_RETURN_IF_ERROR(solve(false).status());
  std::vector<SceneLevels> levels(graph.scenes.size());
  if (features) {
    ContentRounds rounds(graph, features, options.threads);
    TREM_RETURN_IF_ERROR(rounds.Extract(tick, [&] { return solve(false).status(); }));
    levels = rounds.TakeLevels();
    for (int round = 0; round < kContentRounds; ++round) {
      const std::size_t before = content.size();
      TREM_ASSIGN_OR_RETURN(const int found, rounds.Find(state, tick, content));
      if (found == 0) break;
      solution.join_count += JoinPieces(graph, std::span(content).subspan(before), state);
      TREM_RETURN_IF_ERROR(solve(false).status());
    }
  }
  TREM_ASSIGN_OR_RETURN(const SolveReport report, solve(true));
  UpdateShifts(graph, Shifts::kPlaces, state);
  const std::vector<LevelTie> level_ties = FindLevelTies(graph, state, levels, options.threads);
  TREM_ASSIGN_OR_RETURN(const PhotometricBalance balance, Balance(graph, level_ties));

  solution.georeferenced = AnyPieceAnchored(state);
  CollectScenes(graph, state, report, balance, solution);
  if (solution.scenes.empty()) {
    return Failed("none of the " + std::to_string(graph.scenes.size()) +
                  " enhanced scenes could be placed: " + std::to_string(solution.unplaced_scenes.size()) +
                  " have no connection to a frame with telemetry, " + std::to_string(solution.insane_scenes.size()) +
                  " have no credible map; check telemetry and its ground elevation, or set telemetry.ignore");
  }
  CollectFrames(graph, state, balance, solution);
  LayOutPieces(graph, solution);
  CollectTies(graph, state, report, solution);
  CollectPairs(graph, content, report, solution);
  solution.control = CheckControl(graph, state, report);
  solution.lens = state.lens;
  solution.vignetting = balance.vignetting;
  solution.level_tie_count = static_cast<int>(level_ties.size());
  solution.gauge = GaugeText(graph, options, state, solution);
  solution.used_frame_count = static_cast<int>(graph.frames.size());
  solution.content_tie_count = static_cast<int>(content.size());
  solution.content_point_count = report.content_point_count;
  solution.content_outlier_count = report.content_outlier_count;
  solution.tie_rms_px = report.tie_rms_px;
  solution.variance_factor = report.variance_factor;
  return solution;
}

}  // namespace trem::align
