#include "mosaic/align/photometry.h"

#include <ceres/ceres.h>

#include <Eigen/Cholesky>
#include <array>
#include <cmath>

namespace trem::align {
namespace {

// Grey level at which gain and offset are told apart: the middle of the internal scale.
constexpr double kPivot = 128.0;
// What a view's gain and its level at the pivot leave unexplained (vignetting, content that changed).
constexpr double kGainFloor = 0.003;
constexpr double kLevelFloor = 0.3;

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

Result<PhotometricBalance> Balance(const AlignGraph& graph) {
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
  for (const auto& [log_gain, offset] : scenes) balance.balanced_from_scene.push_back({std::exp(-log_gain), -offset * std::exp(-log_gain)});
  for (const auto& [log_gain, offset] : frames) balance.frame_from_balanced.push_back({std::exp(log_gain), offset});
  return balance;
}

}  // namespace trem::align
