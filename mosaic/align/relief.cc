#include "mosaic/align/relief.h"

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

namespace trem::align {
namespace {

// Cells between nodes, in sensor pixels: hills that matter at this distance are found by no view anyway.
constexpr double kNodePx = 8.0;
constexpr int kNodesMax = 40;  // Along a side.
// Nodes beyond the scene's raster, as part of its side.
constexpr double kMargin = 0.1;

// The plane z = p0 + p1 x + p2 y, about `centre`, that fits places and elevations best.
class Plane {
 public:
  static std::optional<Plane> Fit(const std::vector<Eigen::Vector2d>& places, const std::vector<double>& elevations_m) {
    if (places.size() < 3) return std::nullopt;
    Plane plane;
    for (const Eigen::Vector2d& x : places) plane.centre_ += x / static_cast<double>(places.size());
    Eigen::MatrixX3d rows(static_cast<Eigen::Index>(places.size()), 3);
    Eigen::VectorXd z(static_cast<Eigen::Index>(places.size()));
    for (std::size_t i = 0; i < places.size(); ++i) {
      const auto row = static_cast<Eigen::Index>(i);
      rows.row(row) << 1.0, (places[i] - plane.centre_).transpose();
      z(row) = elevations_m[i];
    }
    plane.coefficients_ = rows.colPivHouseholderQr().solve(z);
    return plane;
  }
  double operator()(const Eigen::Vector2d& x) const { return coefficients_(0) + coefficients_.tail<2>().dot(x - centre_); }

 private:
  Eigen::Vector2d centre_ = Eigen::Vector2d::Zero();
  Eigen::Vector3d coefficients_ = Eigen::Vector3d::Zero();
};

// How much a frame says of a node: 1 within its ROI, fading over a tenth of the ROI outside, but never quite nothing.
double WeightOf(const Roi& roi, const Eigen::Vector2d& u) {
  const Eigen::Vector2d low(roi.x0, roi.y0), high(roi.x1 - 1.0, roi.y1 - 1.0);
  const Eigen::Vector2d outside = (low - u).cwiseMax(u - high).cwiseMax(Eigen::Vector2d::Zero());
  const double distance = outside.norm() / (0.1 * std::max(roi.width(), roi.height()));
  return std::exp(-0.5 * distance * distance) + 1e-6 / (1.0 + distance * distance);
}

// The nodes of a scene and the ground below them.
struct Nodes {
  std::vector<Eigen::Vector2d> cells, places;
  std::vector<double> surface_m, plane_m;
};

// Nothing when too little of the ground is known to fit a plane; where nothing is known, the plane.
std::optional<Nodes> NodesOf(const CellShifts& grid, const GroundSurface& ground, const Roi& roi, const Homography& world_from_scene) {
  Nodes nodes;
  std::vector<Eigen::Vector2d> known;
  std::vector<double> known_m;
  std::vector<std::optional<double>> elevations_m;
  for (int row = 0; row < grid.rows; ++row) {
    for (int column = 0; column < grid.columns; ++column) {
      const Eigen::Vector2d c = grid.Node(column, row);
      nodes.cells.push_back(c);
      nodes.places.push_back(world_from_scene * c);
      const std::optional<double> z = ground.ElevationAt(nodes.places.back());
      elevations_m.push_back(z);
      if (z && c.x() >= roi.x0 && c.y() >= roi.y0 && c.x() < roi.x1 && c.y() < roi.y1) {
        known.push_back(nodes.places.back());
        known_m.push_back(*z);
      }
    }
  }
  const std::optional<Plane> plane = Plane::Fit(known, known_m);
  if (!plane) return std::nullopt;
  for (std::size_t i = 0; i < nodes.places.size(); ++i) {
    nodes.plane_m.push_back((*plane)(nodes.places[i]));
    nodes.surface_m.push_back(elevations_m[i].value_or(nodes.plane_m.back()));
  }
  return nodes;
}

// What a frame shows of a node: cells that it is shifted by, and how much the frame says of it.
struct Seen {
  Eigen::Vector2d shift = Eigen::Vector2d::Zero();
  double weight = 0.0;
};

std::vector<Seen> SeenBy(const Camera& camera, const Lens& lens, const AlignGraph& graph, const Tie& tie, Shifts kind, const Nodes& nodes) {
  const PlanarMap& view = graph.ViewOf(tie).scene_from_sensor;
  const Roi& roi = graph.SegmentOf(tie).roi_in_sensor;
  std::vector<Seen> seen(nodes.places.size());
  for (std::size_t i = 0; i < nodes.places.size(); ++i) {
    const Eigen::Vector2d& x = nodes.places[i];
    const auto surface = PixelOf(camera, lens, graph.input, {x.x(), x.y(), nodes.surface_m[i]});
    const auto level = PixelOf(camera, lens, graph.input, {x.x(), x.y(), nodes.plane_m[i]});
    if (!surface || !level) continue;
    const Eigen::Vector2d without = kind == Shifts::kRelief ? view * *level : nodes.cells[i];
    seen[i] = {view * *surface - without, WeightOf(roi, *surface)};
  }
  return seen;
}

// Rms of one coordinate of what is left of the differences between a frame's shifts and the scene's beside the affine map of cells that
// fits them best, cells.
double BesideAffine(const std::vector<Seen>& seen, const CellShifts& shifts, const Nodes& nodes) {
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  double weights = 0.0;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    centre += seen[i].weight * nodes.cells[i];
    weights += seen[i].weight;
  }
  if (!(weights > 0.0)) return 0.0;
  centre /= weights;
  Eigen::Matrix3d normal = Eigen::Matrix3d::Identity() * 1e-9;
  Eigen::Matrix<double, 3, 2> right = Eigen::Matrix<double, 3, 2>::Zero();
  double squares = 0.0;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    const Eigen::Vector2d difference = seen[i].shift - shifts.values[i];
    const Eigen::Vector3d row((nodes.cells[i] - centre).x(), (nodes.cells[i] - centre).y(), 1.0);
    normal += seen[i].weight * row * row.transpose();
    right += seen[i].weight * row * difference.transpose();
    squares += seen[i].weight * difference.squaredNorm();
  }
  const double explained = (right.transpose() * normal.ldlt().solve(right)).trace();
  return std::sqrt(std::max(0.0, squares - explained) / (2.0 * weights));
}

// The shifts of scene `s`; with kRelief AlignState::tie_relief_px of its ties, too.
CellShifts ShiftsOf(const AlignGraph& graph, Shifts kind, std::size_t s, AlignState& state) {
  const SceneNode& node = graph.scenes[s];
  const Roi& roi = node.scene.roi_in_scene;
  const double margin = kMargin * std::max(roi.width(), roi.height());
  const Eigen::Vector2d low(roi.x0 - margin, roi.y0 - margin), high(roi.x1 - 1.0 + margin, roi.y1 - 1.0 + margin);
  const double spacing = std::max(kNodePx * graph.input.ratio, (high - low).maxCoeff() / kNodesMax);
  CellShifts shifts = CellShifts::Over(low, high, spacing, Eigen::Vector2d::Zero());
  const std::optional<Nodes> nodes = NodesOf(shifts, *graph.input.ground, roi, state.scenes[s].world_from_scene);
  if (!nodes) return {};
  std::vector<std::pair<std::size_t, std::vector<Seen>>> seen_by_tie;
  std::vector<double> weights(nodes->cells.size(), 0.0);
  for (const int t : node.ties) {
    const Tie& tie = graph.ties[static_cast<std::size_t>(t)];
    const FrameState& frame = state.frames[static_cast<std::size_t>(tie.frame)];
    const std::uint32_t index = graph.frames[static_cast<std::size_t>(tie.frame)].frame;
    const bool dominates = node.ties.size() < 2 || (index >= node.scene.frame_begin && index < node.scene.frame_end);
    if (!frame.camera || state.tie_unusable[static_cast<std::size_t>(t)]) continue;
    std::vector<Seen> seen = SeenBy(*frame.camera, state.lens, graph, tie, kind, *nodes);
    for (std::size_t i = 0; i < seen.size() && dominates; ++i) {
      shifts.values[i] += seen[i].weight * seen[i].shift;
      weights[i] += seen[i].weight;
    }
    seen_by_tie.emplace_back(static_cast<std::size_t>(t), std::move(seen));
  }
  for (std::size_t i = 0; i < weights.size(); ++i) {
    if (!(weights[i] > 0.0)) return {};
    shifts.values[i] /= weights[i];
  }
  const double alike = std::sqrt(static_cast<double>(seen_by_tie.size()));
  for (const auto& [t, seen] : seen_by_tie) {
    if (kind == Shifts::kRelief) state.tie_relief_px[t] = alike * BesideAffine(seen, shifts, *nodes) / graph.input.ratio;
  }
  return shifts;
}

}  // namespace

void UpdateShifts(const AlignGraph& graph, Shifts kind, AlignState& state) {
  if (!graph.input.ground || graph.input.ground->spacing() == 0.0) return;
  for (std::size_t s = 0; s < graph.scenes.size(); ++s) {
    SceneState& scene = state.scenes[s];
    if (scene.piece >= 0) scene.shifts = ShiftsOf(graph, kind, s, state);
  }
}

}  // namespace trem::align
