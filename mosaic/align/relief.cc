#include "mosaic/align/relief.h"

#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <optional>
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

struct Seen {
  Eigen::Vector2d shift_sum = Eigen::Vector2d::Zero();
  double weight = 0.0;
};

CellShifts ShiftsOf(const AlignGraph& graph, const AlignState& state, const SceneNode& node, Shifts kind, const SceneState& scene) {
  const AlignInput& input = graph.input;
  const Roi& roi = node.scene.roi_in_scene;
  const double margin = kMargin * std::max(roi.width(), roi.height());
  const Eigen::Vector2d low(roi.x0 - margin, roi.y0 - margin), high(roi.x1 - 1.0 + margin, roi.y1 - 1.0 + margin);
  const double spacing = std::max(kNodePx * input.ratio, (high - low).maxCoeff() / kNodesMax);
  CellShifts shifts = CellShifts::Over(low, high, spacing, Eigen::Vector2d::Zero());
  std::vector<Eigen::Vector2d> places, cells, known;
  std::vector<std::optional<double>> elevations_m;
  std::vector<double> known_m;
  for (int row = 0; row < shifts.rows; ++row) {
    for (int column = 0; column < shifts.columns; ++column) {
      const Eigen::Vector2d c = shifts.Node(column, row);
      cells.push_back(c);
      places.push_back(scene.world_from_scene * c);
      const std::optional<double> z = input.ground->ElevationAt(places.back());
      elevations_m.push_back(z);
      if (z && c.x() >= roi.x0 && c.y() >= roi.y0 && c.x() < roi.x1 && c.y() < roi.y1) {
        known.push_back(places.back());
        known_m.push_back(*z);
      }
    }
  }
  const std::optional<Plane> plane = Plane::Fit(known, known_m);
  if (!plane) return {};
  // Where nothing is known, the plane.
  const auto elevation_m = [&](std::size_t i) { return elevations_m[i].value_or((*plane)(places[i])); };
  std::vector<Seen> seen(places.size());
  for (const int t : node.ties) {
    const Tie& tie = graph.ties[static_cast<std::size_t>(t)];
    const FrameState& frame = state.frames[static_cast<std::size_t>(tie.frame)];
    const std::uint32_t index = graph.frames[static_cast<std::size_t>(tie.frame)].frame;
    const bool dominates = node.ties.size() < 2 || (index >= node.scene.frame_begin && index < node.scene.frame_end);
    if (!frame.camera || state.tie_unusable[static_cast<std::size_t>(t)] || !dominates) continue;
    const PlanarMap& view = graph.ViewOf(tie).scene_from_sensor;
    const Roi& sensor = graph.SegmentOf(tie).roi_in_sensor;
    for (std::size_t i = 0; i < places.size(); ++i) {
      const auto surface = PixelOf(*frame.camera, state.lens, input, {places[i].x(), places[i].y(), elevation_m(i)});
      const auto level = PixelOf(*frame.camera, state.lens, input, {places[i].x(), places[i].y(), (*plane)(places[i])});
      if (!surface || !level) continue;
      const double weight = WeightOf(sensor, *surface);
      const Eigen::Vector2d without = kind == Shifts::kRelief ? view * *level : cells[i];
      seen[i].shift_sum += weight * (view * *surface - without);
      seen[i].weight += weight;
    }
  }
  for (std::size_t i = 0; i < places.size(); ++i) {
    if (!(seen[i].weight > 0.0)) return {};
    shifts.values[i] = seen[i].shift_sum / seen[i].weight;
  }
  return shifts;
}

}  // namespace

void UpdateShifts(const AlignGraph& graph, Shifts kind, AlignState& state) {
  if (!graph.input.ground || graph.input.ground->spacing() == 0.0) return;
  for (std::size_t s = 0; s < graph.scenes.size(); ++s) {
    SceneState& scene = state.scenes[s];
    if (scene.piece >= 0) scene.shifts = ShiftsOf(graph, state, graph.scenes[s], kind, scene);
  }
}

}  // namespace trem::align
