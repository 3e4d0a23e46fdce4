#include "mosaic/align/control.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>

namespace trem::align {
namespace {

// Squared error with two degrees of freedom above which a control point is an outlier: chance 4e-6 for a good one.
constexpr double kOutlierNorm2 = 25.0;

double Median(std::vector<double> values) {
  if (values.empty()) return 0.0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

std::optional<Eigen::Vector2d> PlaceOf(const FrameState& frame, const Lens& lens, const AlignInput& input, const Eigen::Vector2d& u) {
  if (!frame.camera) {
    if (!(frame.world_from_sensor.Depth(u) > 0.0)) return std::nullopt;
    return frame.world_from_sensor * u;
  }
  const std::optional<Eigen::Vector3d> place = MeetGround(*frame.camera, lens, input, u);
  if (!place) return std::nullopt;
  return place->head<2>();
}

ControlFit FitOf(const std::map<std::string, std::vector<Eigen::Vector2d>>& errors) {
  ControlFit fit;
  std::vector<double> distances;
  for (const auto& [name, of_point] : errors) {
    Eigen::Vector2d mean = Eigen::Vector2d::Zero();
    for (const Eigen::Vector2d& error : of_point) mean += error / static_cast<double>(of_point.size());
    distances.push_back(mean.norm());
    fit.rmse_m += mean.squaredNorm();
  }
  fit.point_count = static_cast<int>(distances.size());
  if (distances.empty()) return fit;
  fit.rmse_m = std::sqrt(fit.rmse_m / static_cast<double>(distances.size()));
  constexpr std::size_t kEnoughPoints = 10;
  constexpr double kCe90OfRmse = 1.5175;
  if (distances.size() < kEnoughPoints) {
    fit.ce90_m = kCe90OfRmse * fit.rmse_m;
    return fit;
  }
  std::sort(distances.begin(), distances.end());
  fit.ce90_m = distances[static_cast<std::size_t>(std::ceil(0.9 * static_cast<double>(distances.size()))) - 1];
  return fit;
}

}  // namespace

ControlReport CheckControl(const AlignGraph& graph, const AlignState& state, const SolveReport& report) {
  ControlReport result;
  const AlignInput& input = graph.input;
  const double place_sigma_m = Median(report.scene_sigma);
  std::set<std::string> named, placed;
  std::map<std::string, std::vector<Eigen::Vector2d>> constraints, checks;
  for (std::size_t c = 0; c < input.control.size(); ++c) {
    const ControlObservation& control = input.control[c];
    named.insert(control.name);
    const auto node = std::lower_bound(graph.frames.begin(), graph.frames.end(), control.frame,
                                       [](const FrameNode& n, std::uint32_t frame) { return n.frame < frame; });
    if (node == graph.frames.end() || node->frame != control.frame) continue;
    const FrameState& frame = state.frames[static_cast<std::size_t>(node - graph.frames.begin())];
    if (frame.piece < 0 || !state.piece_anchored[static_cast<std::size_t>(frame.piece)]) continue;
    const std::optional<Eigen::Vector2d> place = PlaceOf(frame, state.lens, input, control.u);
    if (!place) continue;
    placed.insert(control.name);
    AlignedControl aligned{control.name, control.frame, control.held_out, false, *place - control.x_in_world.head<2>()};
    const double gsd_m = std::sqrt(std::abs(frame.world_from_sensor.LinearisedAt(control.u).linear.determinant()));
    const double sigma_m = std::hypot(place_sigma_m, input.control_sigma_m, input.control_sigma_px * gsd_m);
    // A constraint without a residual was out of the camera's sight from the start.
    const double norm2 = control.held_out || report.control_norm2[c] < 0.0 ? aligned.error_m.squaredNorm() / (sigma_m * sigma_m)
                                                                           : report.control_norm2[c];
    aligned.outlier = norm2 > kOutlierNorm2;
    if (control.held_out) checks[control.name].push_back(aligned.error_m);
    if (!control.held_out && !aligned.outlier) constraints[control.name].push_back(aligned.error_m);
    result.observations.push_back(aligned);
  }
  result.constraints = FitOf(constraints);
  result.checks = FitOf(checks);
  std::set_difference(named.begin(), named.end(), placed.begin(), placed.end(), std::back_inserter(result.unseen));
  return result;
}

}  // namespace trem::align
