#include "mosaic/align/photometry.h"

#include <ceres/ceres.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>

namespace trem::align {
namespace {

// Grey level at which gain and offset are told apart: the middle of the internal scale.
constexpr double kPivot = 128.0;
// What a view's gain and its level at the pivot leave unexplained (vignetting, content that changed).
constexpr double kGainFloor = 0.003;
constexpr double kLevelFloor = 0.3;
// Standard deviation of the difference of a patch in two balanced scenes, and how many patches of a pair count in full.
constexpr double kPatchSigma = 2.0;
constexpr double kPatchesIndependent = 8.0;

struct ViewResidual {
  double gain;
  double offset;
  Eigen::Matrix2d whitener;

  template <typename T>
  bool operator()(const T* frame, const T* scene, T* residuals) const {
    using std::exp;
    const T predicted_gain = exp(frame[0] - scene[0]);
    const T predicted_offset = frame[1] - predicted_gain * scene[1];
    const Eigen::Matrix<T, 2, 1> error(predicted_gain - gain, predicted_offset - offset);
    Eigen::Map<Eigen::Matrix<T, 2, 1>> out(residuals);
    out = whitener.cast<T>() * error;
    return true;
  }
};

// One patch in two scenes, in units of its standard deviation.
struct LevelResidual {
  LevelPair pair;
  double sigma;

  template <typename T>
  bool operator()(const T* a, const T* b, const T* vignetting, T* residuals) const {
    using std::exp;
    using std::sqrt;
    const auto lens = [&](const FieldPowers& field) -> T { return 1.0 + vignetting[0] * field.second + vignetting[1] * field.fourth; };
    const T lens_a = lens(pair.field_a), lens_b = lens(pair.field_b);
    if (!(lens_a > 0.05) || !(lens_b > 0.05)) return false;
    const T difference = (pair.level_a / lens_a - a[1]) * exp(-a[0]) - (pair.level_b / lens_b - b[1]) * exp(-b[0]);
    // In levels of the scenes: balanced ones would differ less the darker everything is made.
    residuals[0] = difference * exp(0.5 * (a[0] + b[0])) * sqrt(lens_a * lens_b) / sigma;
    return true;
  }
};

// Lenses darken corners by tens of per cent at most.
struct VignettingPrior {
  template <typename T>
  bool operator()(const T* v, T* residuals) const {
    residuals[0] = v[0] / 0.3;
    residuals[1] = v[1] / 0.3;
    return true;
  }
};

struct FramePrior {
  template <typename T>
  bool operator()(const T* frame, T* residuals) const {
    using std::exp;
    residuals[0] = frame[0] / 0.2;
    residuals[1] = (exp(frame[0]) * kPivot + frame[1] - kPivot) / 20.0;
    return true;
  }
};

Eigen::Matrix2d ViewWhitener(const ChainView& view) {
  Eigen::Matrix2d covariance = view.gain_offset_covariance;
  covariance(0, 0) += kGainFloor * kGainFloor;
  covariance(0, 1) -= kPivot * kGainFloor * kGainFloor;
  covariance(1, 0) -= kPivot * kGainFloor * kGainFloor;
  covariance(1, 1) += kLevelFloor * kLevelFloor + kPivot * kPivot * kGainFloor * kGainFloor;
  const Eigen::LLT<Eigen::Matrix2d> llt(covariance);
  TREM_CHECK(llt.info() == Eigen::Success);
  return llt.matrixL().solve(Eigen::Matrix2d::Identity());
}

}  // namespace

Result<PhotometricBalance> Balance(const AlignGraph& graph, std::span<const LevelTie> level_ties) {
  std::vector<std::array<double, 2>> frames(graph.frames.size(), {0.0, 0.0});
  std::vector<std::array<double, 2>> scenes(graph.scenes.size(), {0.0, 0.0});
  ceres::Problem::Options problem_options;
  problem_options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::CauchyLoss loss(3.0);
  ceres::Problem problem(problem_options);
  for (auto& frame : frames)
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<FramePrior, 2, 2>(new FramePrior), nullptr, frame.data());
  for (const Tie& tie : graph.ties) {
    const ChainView& view = graph.ViewOf(tie);
    if (!(view.gain > 1e-3)) continue;
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<ViewResidual, 2, 2, 2>(new ViewResidual{view.gain, view.offset, ViewWhitener(view)}), &loss,
        frames[static_cast<std::size_t>(tie.frame)].data(), scenes[static_cast<std::size_t>(tie.scene)].data());
  }
  std::array<double, 2> vignetting = {0.0, 0.0};
  ceres::CauchyLoss level_loss(2.0);
  problem.AddResidualBlock(new ceres::AutoDiffCostFunction<VignettingPrior, 2, 2>(new VignettingPrior), nullptr, vignetting.data());
  for (const LevelTie& tie : level_ties) {
    // Patches of one pair of scenes err alike (shadows, movers, reflectance): many count no more than some.
    const double sigma = kPatchSigma * std::sqrt(std::max(1.0, static_cast<double>(tie.pairs.size()) / kPatchesIndependent));
    for (const LevelPair& pair : tie.pairs) {
      problem.AddResidualBlock(new ceres::AutoDiffCostFunction<LevelResidual, 1, 2, 2, 2>(new LevelResidual{pair, sigma}), &level_loss,
                               scenes[static_cast<std::size_t>(tie.scene_a)].data(), scenes[static_cast<std::size_t>(tie.scene_b)].data(),
                               vignetting.data());
    }
  }
  if (level_ties.empty()) problem.SetParameterBlockConstant(vignetting.data());
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  options.sparse_linear_algebra_library_type = ceres::EIGEN_SPARSE;
  options.num_threads = 1;
  options.max_num_iterations = 50;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  if (!summary.IsSolutionUsable()) return Failed("the photometric balance could not be solved: " + summary.message);
  PhotometricBalance balance;
  balance.vignetting = {vignetting[0], vignetting[1]};
  for (const auto& [log_gain, offset] : scenes) balance.balanced_from_scene.push_back({std::exp(-log_gain), -offset * std::exp(-log_gain)});
  for (const auto& [log_gain, offset] : frames) balance.frame_from_balanced.push_back({std::exp(log_gain), offset});
  return balance;
}

CellGrid<double> ShadeOf(const AlignGraph& graph, int scene, const Vignetting& vignetting) {
  constexpr int kIntervals = 8;
  constexpr double kFaint = 0.004;
  const Roi& roi = graph.scenes[static_cast<std::size_t>(scene)].scene.roi_in_scene;
  const Eigen::Vector2d low(roi.x0, roi.y0), high(roi.x1 - 1.0, roi.y1 - 1.0);
  double strongest = 0.0;
  for (const double r2 : {0.25, 0.5, 0.75, 1.0}) strongest = std::max(strongest, std::abs(vignetting.At({r2, r2 * r2}) - 1.0));
  if (strongest < kFaint) return {};
  CellGrid<double> shade = CellGrid<double>::Over(low, high, (high - low).maxCoeff() / kIntervals, 1.0);
  for (int row = 0; row < shade.rows; ++row) {
    for (int column = 0; column < shade.columns; ++column) {
      const double factor = vignetting.At(FieldPowersAt(graph, scene, shade.Node(column, row)));
      shade.values[static_cast<std::size_t>(row * shade.columns + column)] = 1.0 / std::max(0.1, factor);
    }
  }
  return shade;
}

}  // namespace trem::align
