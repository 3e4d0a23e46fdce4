#include "mosaic/align/solver.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>

#include "mosaic/align/equations.h"

namespace trem::align {
namespace {

constexpr double kTieDegrees = 8.0;
constexpr double kMedianChi2With8 = 7.344;
constexpr double kMedianChi2With6 = 5.348;

// Of affine views seen by cameras six of a tie's eight residuals are free.
bool HasSixDegrees(const AlignGraph& graph, const AlignState& state, const Tie& tie) {
  return state.frames[static_cast<std::size_t>(tie.frame)].camera.has_value() && graph.ViewOf(tie).corner_covariance_px2.rows() == 6;
}

double VarianceFactor(const AlignGraph& graph, const AlignState& state, const SolveReport& report) {
  std::vector<double> norms;
  for (std::size_t t = 0; t < graph.ties.size(); ++t) {
    if (report.tie_norm2[t] < 0.0) continue;
    norms.push_back(report.tie_norm2[t] / (HasSixDegrees(graph, state, graph.ties[t]) ? kMedianChi2With6 : kMedianChi2With8));
  }
  if (norms.empty()) return 1.0;
  const auto middle = norms.begin() + static_cast<std::ptrdiff_t>(norms.size() / 2);
  std::nth_element(norms.begin(), middle, norms.end());
  return std::max(1.0, *middle);
}

}  // namespace

void Equations::EvaluateTies(double factor, SolveReport& report) {
  report.tie_norm2.assign(graph_.ties.size(), -1.0);
  report.tie_error2_px2.assign(graph_.ties.size(), -1.0);
  std::vector<double> squares;
  for (std::size_t t = 0; t < graph_.ties.size(); ++t) {
    if (tie_blocks_[t] == nullptr) continue;
    Eigen::Matrix<double, 8, 1> whitened;
    double cost = 0.0;
    if (!problem_->EvaluateResidualBlock(tie_blocks_[t], false, &cost, whitened.data(), nullptr)) continue;
    report.tie_norm2[t] = whitened.squaredNorm() / factor;
    const Whitener8 whitener = TieWhitener(graph_.ViewOf(graph_.ties[t]).corner_covariance_px2, FloorPx(t));
    const Eigen::Matrix<double, 8, 1> error_px = whitener.triangularView<Eigen::Lower>().solve(whitened);
    report.tie_error2_px2[t] = error_px.squaredNorm() / kTieDegrees;
    for (int k = 0; k < 8; ++k) squares.push_back(error_px(k) * error_px(k));
  }
  if (squares.empty()) return;
  const auto middle = squares.begin() + static_cast<std::ptrdiff_t>(squares.size() / 2);
  std::nth_element(squares.begin(), middle, squares.end());
  constexpr double kMedianChi2With1 = 0.4549;
  report.tie_rms_px = std::sqrt(*middle / kMedianChi2With1);
}

void Equations::EvaluateContent(SolveReport& report) {
  report.content_point_count = static_cast<int>(content_blocks_.size());
  report.content_outlier_count = 0;
  const std::size_t tie_count = content_tie_of_block_.empty() ? 0 : static_cast<std::size_t>(content_tie_of_block_.back()) + 1;
  std::vector<int> points(tie_count, 0), outliers(tie_count, 0);
  report.content_error_px.assign(tie_count, 0.0);
  report.content_tie_outlier.assign(tie_count, false);
  for (std::size_t b = 0; b < content_blocks_.size(); ++b) {
    Eigen::Vector2d whitened;
    double cost = 0.0;
    if (!problem_->EvaluateResidualBlock(content_blocks_[b], false, &cost, whitened.data(), nullptr)) continue;
    const auto tie = static_cast<std::size_t>(content_tie_of_block_[b]);
    ++points[tie];
    report.content_error_px[tie] += whitened.squaredNorm() * options_.content_sigma_px * options_.content_sigma_px;
    if (whitened.norm() <= 4.0) continue;
    ++outliers[tie];
    ++report.content_outlier_count;
  }
  for (std::size_t tie = 0; tie < tie_count; ++tie) {
    report.content_error_px[tie] = std::sqrt(report.content_error_px[tie] / std::max(1, points[tie]));
    report.content_tie_outlier[tie] = 2 * outliers[tie] > points[tie];
  }
}

void Equations::EvaluateControl(SolveReport& report) {
  report.control_norm2.assign(control_blocks_.size(), -1.0);
  for (std::size_t c = 0; c < control_blocks_.size(); ++c) {
    Eigen::Vector2d whitened;
    double cost = 0.0;
    if (control_blocks_[c] == nullptr || !problem_->EvaluateResidualBlock(control_blocks_[c], false, &cost, whitened.data(), nullptr))
      continue;
    report.control_norm2[c] = whitened.squaredNorm();
  }
}

Status Equations::ComputeSigmas(SolveReport& report) {
  // Held or not, the shared attitude error is part of what is not known of the absolute place.
  for (auto& [recording, shared] : shared_) {
    if (shared.has_attitude) problem_->SetParameterBlockVariable(shared.attitude.data());
  }
  ceres::Problem::EvaluateOptions evaluate;
  evaluate.num_threads = 1;
  int columns = 0;
  const auto take = [&](double* parameters, int size) {
    if (problem_->IsParameterBlockConstant(parameters)) return;
    evaluate.parameter_blocks.push_back(parameters);
    columns += size;
  };
  std::vector<int> used;
  for (std::size_t s = 0; s < graph_.scenes.size(); ++s) {
    if (!InUse(static_cast<int>(s))) continue;
    take(scene_parameters_[s].data(), kMapParameters);
    used.push_back(static_cast<int>(s));
  }
  for (std::size_t f = 0; f < graph_.frames.size(); ++f) {
    if (state_.frames[f].piece >= 0) take(frame_parameters_[f].data(), state_.frames[f].camera ? kCameraParameters : kMapParameters);
  }
  for (auto& [recording, shared] : shared_) {
    take(shared.position.data(), 3);
    if (shared.has_attitude) take(shared.attitude.data(), 3);
  }
  const ceres::Manifold* const lens = problem_->GetManifold(lens_.data());
  take(lens_.data(), lens == nullptr ? kLensParameters : lens->TangentSize());
  ceres::CRSMatrix crs;
  if (used.empty() || !problem_->Evaluate(evaluate, nullptr, nullptr, nullptr, &crs))
    return Failed("the alignment's Jacobian can't be evaluated");
  const Eigen::Map<const Eigen::SparseMatrix<double, Eigen::RowMajor>> jacobian(
      crs.num_rows, crs.num_cols, static_cast<Eigen::Index>(crs.values.size()), crs.rows.data(), crs.cols.data(), crs.values.data());
  const Eigen::SparseMatrix<double> columns_first = jacobian;
  const Eigen::SparseMatrix<double> normal = columns_first.transpose() * columns_first;
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> ldlt(normal);
  if (ldlt.info() != Eigen::Success) return Failed("the alignment's normal equations are singular");

  constexpr std::size_t kSolvedMax = 500;
  const std::size_t step = (used.size() + kSolvedMax - 1) / kSolvedMax;
  report.scene_sigma.assign(graph_.scenes.size(), 0.0);
  double sigma = 0.0;
  for (std::size_t n = 0; n < used.size(); ++n) {
    const auto s = static_cast<std::size_t>(used[n]);
    if (n % step == 0) {
      const int centre_columns[2] = {static_cast<int>(n) * kMapParameters + 2, static_cast<int>(n) * kMapParameters + 5};
      Eigen::Matrix2d covariance;
      for (int c = 0; c < 2; ++c) {
        Eigen::VectorXd unit = Eigen::VectorXd::Zero(columns);
        unit(centre_columns[c]) = 1.0;
        const Eigen::VectorXd column = ldlt.solve(unit);
        for (int r = 0; r < 2; ++r) covariance(r, c) = column(centre_columns[r]);
      }
      const auto& d = scene_parameters_[s];
      const Eigen::Matrix2d world_from_step = Homography{world_from_unit_[s]}.LinearisedAt({d[2], d[5]}).linear;
      const Eigen::Matrix2d in_world = world_from_step * covariance * world_from_step.transpose();
      sigma = std::sqrt(std::max(0.0, Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(in_world).eigenvalues()(1)));
    }
    report.scene_sigma[s] = sigma;
  }
  return {};
}

Result<SolveReport> Solve(const AlignGraph& graph, std::span<const ContentTie> content_ties, const AlignOptions& options, bool with_sigma,
                          const std::function<bool()>& progress, AlignState& state) {
  Equations equations(graph, content_ties, options, state);
  SolveReport report;
  TREM_ASSIGN_OR_RETURN(report.converged, equations.Minimise(progress));
  equations.EvaluateTies(1.0, report);
  report.variance_factor = VarianceFactor(graph, state, report);
  equations.SetCauchy(report.variance_factor);
  TREM_ASSIGN_OR_RETURN(report.converged, equations.Minimise(progress));
  equations.EvaluateTies(report.variance_factor, report);
  equations.EvaluateContent(report);
  equations.EvaluateControl(report);
  if (with_sigma) TREM_RETURN_IF_ERROR(equations.ComputeSigmas(report));
  equations.Store();
  return report;
}

}  // namespace trem::align
