#include "mosaic/align/solver.h"

#include <ceres/ceres.h>
#include <ceres/normal_prior.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <numeric>
#include <string>

#include "mosaic/align/residuals.h"

namespace trem::align {

Whitener8 TieWhitener(const CornerCovariance& corner_covariance_px2, double floor_px) {
  const bool projective = corner_covariance_px2.rows() == 8;
  // Corners in the order of RoiCorners; their affine coordinates along the upper and left side.
  constexpr double kAlong[4] = {0.0, 1.0, 1.0, 0.0};
  constexpr double kDown[4] = {0.0, 0.0, 1.0, 1.0};
  constexpr double kIsLowerRight[4] = {0.0, 0.0, 1.0, 0.0};
  Eigen::Matrix<double, 8, Eigen::Dynamic> corners_from_own = Eigen::MatrixXd::Zero(8, corner_covariance_px2.rows());
  for (int k = 0; k < 4; ++k) {
    const double own = projective ? kIsLowerRight[k] : 0.0;
    const double weights[4] = {own > 0.0 ? 0.0 : 1.0 - kAlong[k] - kDown[k], kAlong[k] - own, kDown[k] - own, own};
    for (int c = 0; c < corner_covariance_px2.rows() / 2; ++c) {
      corners_from_own.block<2, 2>(2 * k, 2 * c) = weights[c] * Eigen::Matrix2d::Identity();
    }
  }
  Whitener8 covariance = corners_from_own * corner_covariance_px2 * corners_from_own.transpose();
  covariance.diagonal().array() += floor_px * floor_px;
  const Eigen::LLT<Whitener8> llt(covariance);
  TREM_CHECK(llt.info() == Eigen::Success);
  return llt.matrixL().solve(Whitener8::Identity());
}

namespace {

constexpr double kTieDegrees = 8.0;
constexpr double kMedianChi2With8 = 7.344;

class ProgressCallback : public ceres::IterationCallback {
 public:
  explicit ProgressCallback(const std::function<bool()>& progress) : progress_(progress) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary&) override {
    if (progress_ && !progress_()) {
      cancelled = true;
      return ceres::SOLVER_ABORT;
    }
    return ceres::SOLVER_CONTINUE;
  }
  bool cancelled = false;

 private:
  const std::function<bool()>& progress_;
};

// One least-squares problem over all unknowns, parametrised about the current state.
class Equations {
 public:
  Equations(const AlignGraph& graph, std::span<const ContentTie> content_ties, const AlignOptions& options, AlignState& state);

  // Loss functions of a pass: Huber (first) or Cauchy with the ties' and the content ties' variance factors.
  void SetHuber();
  void SetCauchy(double tie_factor);
  Result<bool> Minimise(const std::function<bool()>& progress);  // True: converged.
  void EvaluateTies(double factor, SolveReport& report);
  void EvaluateContent(SolveReport& report);
  Status ComputeSigmas(SolveReport& report);
  // Moves the solution into the state.
  void Store();

 private:
  // Whether cameras with telemetry look along directions more than 60 degrees apart.
  bool HeadingsDiffer() const;
  FreeProjection FreeProjectionOf(int frame) const;
  void AddFrames();
  void AddScenes();
  void AddAnchorPriors();
  void AddTies();
  void AddContentTies(std::span<const ContentTie> content_ties);
  bool InUse(int scene) const { return state_.scenes[static_cast<std::size_t>(scene)].piece >= 0; }

  const AlignGraph& graph_;
  const AlignOptions& options_;
  AlignState& state_;
  SensorFrame sensor_;
  ceres::LossFunctionWrapper tie_loss_{nullptr, ceres::TAKE_OWNERSHIP};
  ceres::LossFunctionWrapper content_loss_{nullptr, ceres::TAKE_OWNERSHIP};
  std::vector<std::array<double, kMapParameters>> frame_parameters_;  // Cameras use the first six.
  std::vector<std::array<double, kMapParameters>> scene_parameters_;
  std::array<double, 3> position_bias_{};  // Shared by all frames with telemetry, m.
  std::array<double, 3> attitude_bias_{};  // The same, rad, about the camera's axes.
  std::vector<Eigen::Matrix3d> unit_from_scene_;
  std::vector<Eigen::Matrix3d> world_from_unit_;
  std::vector<ceres::ResidualBlockId> tie_blocks_;  // nullptr: unused.
  std::vector<ceres::ResidualBlockId> content_blocks_;
  std::unique_ptr<ceres::Problem> problem_;
  bool has_position_bias_ = false;
  bool has_attitude_bias_ = false;
};

ceres::Problem::Options BorrowedLosses() {
  ceres::Problem::Options options;
  options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  return options;
}

Equations::Equations(const AlignGraph& graph, std::span<const ContentTie> content_ties, const AlignOptions& options, AlignState& state)
    : graph_(graph), options_(options), state_(state), problem_(std::make_unique<ceres::Problem>(BorrowedLosses())) {
  sensor_ = {0.5 * (graph.input.width_px - 1), 0.5 * (graph.input.height_px - 1),
             0.5 * std::max(graph.input.width_px, graph.input.height_px)};
  frame_parameters_.resize(graph.frames.size());
  scene_parameters_.resize(graph.scenes.size());
  for (auto& parameters : frame_parameters_) parameters.fill(0.0);
  for (auto& parameters : scene_parameters_) parameters.fill(0.0);
  for (int k = 0; k < 3; ++k) {
    position_bias_[static_cast<std::size_t>(k)] = state.position_bias_m(k);
    attitude_bias_[static_cast<std::size_t>(k)] = state.attitude_bias_rad(k);
  }
  SetHuber();
  AddFrames();
  AddScenes();
  AddAnchorPriors();
  AddTies();
  AddContentTies(content_ties);
  // A boresight error shows between legs of different headings that meet. On one leg it shows only in the faint perspective of small fields
  // of view and in the bias of feature positions, where a few thousandths of a pixel pass for some hundredths of a degree: there
  // telemetry is believed as it is.
  if (has_attitude_bias_ && (content_ties.empty() || !HeadingsDiffer())) problem_->SetParameterBlockConstant(attitude_bias_.data());
}

bool Equations::HeadingsDiffer() const {
  constexpr double kCosine60Deg = 0.5;
  std::optional<Eigen::Vector2d> first;
  for (const FrameState& frame : state_.frames) {
    if (!frame.camera) continue;
    // The image's right axis is level, or nearly: its direction is the heading whatever the pitch.
    const Eigen::Vector2d right = frame.camera->world_from_camera.col(0).head<2>().normalized();
    if (!first) first = right;
    if (right.dot(*first) < kCosine60Deg) return true;
  }
  return false;
}

void Equations::SetHuber() {
  tie_loss_.Reset(new ceres::HuberLoss(std::sqrt(2.0 * kTieDegrees)), ceres::TAKE_OWNERSHIP);
  content_loss_.Reset(new ceres::HuberLoss(2.0), ceres::TAKE_OWNERSHIP);
}

void Equations::SetCauchy(double tie_factor) {
  const double scale = std::sqrt(2.0 * kTieDegrees * tie_factor);
  tie_loss_.Reset(new ceres::ScaledLoss(new ceres::CauchyLoss(scale), 1.0 / tie_factor, ceres::TAKE_OWNERSHIP), ceres::TAKE_OWNERSHIP);
  content_loss_.Reset(new ceres::CauchyLoss(2.0), ceres::TAKE_OWNERSHIP);
}

FreeProjection Equations::FreeProjectionOf(int frame) const {
  Eigen::Matrix3d unit_from_sensor;
  unit_from_sensor << 1.0 / sensor_.half_px, 0.0, -sensor_.centre_x / sensor_.half_px, 0.0, 1.0 / sensor_.half_px,
      -sensor_.centre_y / sensor_.half_px, 0.0, 0.0, 1.0;
  FreeProjection projection;
  projection.sensor = sensor_;
  const Homography& world_from_sensor = state_.frames[static_cast<std::size_t>(frame)].world_from_sensor;
  projection.unit_from_world = unit_from_sensor * world_from_sensor.matrix.inverse();
  // Third coordinate 1 at the image centre.
  const Eigen::Vector3d centre =
      projection.unit_from_world * (world_from_sensor * Eigen::Vector2d(sensor_.centre_x, sensor_.centre_y)).homogeneous();
  projection.unit_from_world /= centre.z();
  return projection;
}

void Equations::AddFrames() {
  for (std::size_t f = 0; f < state_.frames.size(); ++f) {
    const FrameState& frame = state_.frames[f];
    if (frame.piece < 0) continue;
    double* const parameters = frame_parameters_[f].data();
    problem_->AddParameterBlock(parameters, frame.camera ? kCameraParameters : kMapParameters);
    if (frame.gauge) problem_->SetParameterBlockConstant(parameters);
    if (frame.camera || graph_.frames[f].anchor >= 0) continue;
    const FreeProjection projection = FreeProjectionOf(static_cast<int>(f));
    if (graph_.input.anchors.empty() || !state_.piece_anchored[static_cast<std::size_t>(frame.piece)]) {
      const double log_half = std::log(sensor_.half_px);
      problem_->AddResidualBlock(new ceres::AutoDiffCostFunction<ShapePrior, 3, kMapParameters>(
                                     new ShapePrior{projection.unit_from_world, frame.log_scale0 + log_half}),
                                 nullptr, parameters);
    } else {
      // A frame without telemetry among those with: no idea of its shape, but nothing may stay undetermined.
      problem_->AddResidualBlock(
          new ceres::NormalPrior(Eigen::MatrixXd::Identity(kMapParameters, kMapParameters), Eigen::VectorXd::Zero(kMapParameters)), nullptr,
          parameters);
    }
  }
}

void Equations::AddScenes() {
  unit_from_scene_.resize(graph_.scenes.size());
  world_from_unit_.resize(graph_.scenes.size());
  for (std::size_t s = 0; s < graph_.scenes.size(); ++s) {
    if (!InUse(static_cast<int>(s))) continue;
    const Roi& roi = graph_.scenes[s].scene.roi_in_scene;
    const double half = std::max(1.0, 0.5 * (std::max(roi.width(), roi.height()) - 1));
    const Eigen::Vector2d centre(0.5 * (roi.x0 + roi.x1 - 1), 0.5 * (roi.y0 + roi.y1 - 1));
    unit_from_scene_[s] << 1.0 / half, 0.0, -centre.x() / half, 0.0, 1.0 / half, -centre.y() / half, 0.0, 0.0, 1.0;
    Eigen::Matrix3d scene_from_unit;
    scene_from_unit << half, 0.0, centre.x(), 0.0, half, centre.y(), 0.0, 0.0, 1.0;
    world_from_unit_[s] = state_.scenes[s].world_from_scene.matrix * scene_from_unit;
    world_from_unit_[s] /= world_from_unit_[s](2, 2);
    double* const parameters = scene_parameters_[s].data();
    problem_->AddParameterBlock(parameters, kMapParameters);
    // One half size of freedom: negligible beside any tie; keeps a scene that a single weak view holds from being singular.
    problem_->AddResidualBlock(
        new ceres::NormalPrior(Eigen::MatrixXd::Identity(kMapParameters, kMapParameters), Eigen::VectorXd::Zero(kMapParameters)), nullptr,
        parameters);
  }
}

void Equations::AddAnchorPriors() {
  const AlignInput& input = graph_.input;
  const double white_m = std::max(options_.position_white_min_m, options_.position_white_fraction * input.position_sigma_m);
  for (std::size_t f = 0; f < graph_.frames.size(); ++f) {
    const FrameState& frame = state_.frames[f];
    if (graph_.frames[f].anchor < 0 || frame.piece < 0) continue;
    const FrameAnchor& anchor = input.anchors[static_cast<std::size_t>(graph_.frames[f].anchor)];
    if (frame.camera) {
      const Camera telemetry = CameraFromAnchor(anchor);
      const Eigen::Matrix3d rotation = telemetry.world_from_camera.transpose() * frame.camera->world_from_camera;
      auto* const cost = new ceres::AutoDiffCostFunction<CameraPrior, 6, kCameraParameters, 3, 3>(new CameraPrior{
          frame.camera->position_m - telemetry.position_m, Eigen::Quaterniond(rotation), white_m, input.attitude_sigma_rad});
      problem_->AddResidualBlock(cost, nullptr, frame_parameters_[f].data(), position_bias_.data(), attitude_bias_.data());
      has_attitude_bias_ = true;
    } else {
      const double gsd_m = std::exp(frame.log_scale0);
      const double right = input.width_px - 0.5, bottom = input.height_px - 0.5;
      auto* const cost = new ceres::AutoDiffCostFunction<CornerPrior, 8, kMapParameters, 3>(new CornerPrior{
          FreeProjectionOf(static_cast<int>(f)),
          *anchor.corners,
          {Eigen::Vector2d(-0.5, -0.5), Eigen::Vector2d(right, -0.5), Eigen::Vector2d(right, bottom), Eigen::Vector2d(-0.5, bottom)},
          input.position_sigma_m / gsd_m});
      problem_->AddResidualBlock(cost, nullptr, frame_parameters_[f].data(), position_bias_.data());
    }
    has_position_bias_ = true;
  }
  const auto add_prior = [this](double sigma, double* bias) {
    problem_->AddResidualBlock(new ceres::NormalPrior(Eigen::MatrixXd::Identity(3, 3) / sigma, Eigen::VectorXd::Zero(3)), nullptr, bias);
  };
  if (has_position_bias_) add_prior(input.position_sigma_m, position_bias_.data());
  if (has_attitude_bias_) add_prior(input.attitude_sigma_rad, attitude_bias_.data());
}

void Equations::AddTies() {
  tie_blocks_.assign(graph_.ties.size(), nullptr);
  for (std::size_t t = 0; t < graph_.ties.size(); ++t) {
    const Tie& tie = graph_.ties[t];
    const auto f = static_cast<std::size_t>(tie.frame);
    const auto s = static_cast<std::size_t>(tie.scene);
    if (state_.tie_unusable[t] || !InUse(tie.scene) || state_.frames[f].piece < 0) continue;
    const ChainView& view = graph_.ViewOf(tie);
    const std::array<Eigen::Vector2d, 4> u = RoiCorners(graph_.SegmentOf(tie).roi_in_sensor);
    std::array<Eigen::Vector2d, 4> xi;
    for (std::size_t k = 0; k < 4; ++k) xi[k] = (unit_from_scene_[s] * (view.scene_from_sensor * u[k]).homogeneous()).head<2>();
    const Whitener8 whitener = TieWhitener(view.corner_covariance_px2, tie.floor_px);
    ceres::CostFunction* cost = nullptr;
    if (state_.frames[f].camera) {
      const CameraProjection projection{*state_.frames[f].camera, sensor_, graph_.input.ground_z_m};
      cost = new ceres::AutoDiffCostFunction<TieResidual<CameraProjection>, 8, kCameraParameters, kMapParameters>(
          new TieResidual<CameraProjection>{projection, world_from_unit_[s], xi, u, whitener});
    } else {
      cost = new ceres::AutoDiffCostFunction<TieResidual<FreeProjection>, 8, kMapParameters, kMapParameters>(
          new TieResidual<FreeProjection>{FreeProjectionOf(tie.frame), world_from_unit_[s], xi, u, whitener});
    }
    tie_blocks_[t] = problem_->AddResidualBlock(cost, &tie_loss_, frame_parameters_[f].data(), scene_parameters_[s].data());
  }
}

void Equations::AddContentTies(std::span<const ContentTie> content_ties) {
  for (const ContentTie& tie : content_ties) {
    if (!InUse(tie.scene_a) || !InUse(tie.scene_b)) continue;
    const auto a = static_cast<std::size_t>(tie.scene_a);
    const auto b = static_cast<std::size_t>(tie.scene_b);
    const Homography world_from_a{state_.scenes[a].world_from_scene};
    for (std::size_t k = 0; k < tie.x_in_a.size(); ++k) {
      const Eigen::Matrix2d cells_from_world = world_from_a.LinearisedAt(tie.x_in_a[k]).linear.inverse();
      const Eigen::Matrix2d whitened_from_world = cells_from_world / (graph_.input.ratio * options_.content_sigma_px);
      content_blocks_.push_back(problem_->AddResidualBlock(
          new ceres::AutoDiffCostFunction<ContentResidual, 2, kMapParameters, kMapParameters>(
              new ContentResidual{world_from_unit_[a], world_from_unit_[b], (unit_from_scene_[a] * tie.x_in_a[k].homogeneous()).head<2>(),
                                  (unit_from_scene_[b] * tie.x_in_b[k].homogeneous()).head<2>(), whitened_from_world}),
          &content_loss_, scene_parameters_[a].data(), scene_parameters_[b].data()));
    }
  }
}

Result<bool> Equations::Minimise(const std::function<bool()>& progress) {
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  // Eigen's own factorisation: no BLAS, whose threads and kernels would make the last bits depend on the machine.
  options.sparse_linear_algebra_library_type = ceres::EIGEN_SPARSE;
  options.num_threads = 1;
  options.max_num_iterations = options_.iterations_max;
  // Stiff ties and faint anchors: the place of the whole is a mode some 1e-9 as stiff as a parameter's own curvature. Levenberg's damping,
  // which is relative to the latter, would freeze it, and a tolerance on the cost would not miss it; so nearly Gauss-Newton from the start.
  options.initial_trust_region_radius = 1e14;
  options.function_tolerance = 1e-12;
  options.parameter_tolerance = 1e-12;
  options.logging_type = ceres::SILENT;
  ProgressCallback callback(progress);
  options.callbacks.push_back(&callback);
  ceres::Solver::Summary summary;
  ceres::Solve(options, problem_.get(), &summary);
  if (callback.cancelled) return Cancelled("the alignment was stopped on request");
  if (!summary.IsSolutionUsable()) return Failed("the alignment's equations could not be solved: " + summary.message);
  return summary.termination_type == ceres::CONVERGENCE;
}

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
    const Whitener8 whitener = TieWhitener(graph_.ViewOf(graph_.ties[t]).corner_covariance_px2, graph_.ties[t].floor_px);
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
  for (const ceres::ResidualBlockId block : content_blocks_) {
    Eigen::Vector2d whitened;
    double cost = 0.0;
    if (!problem_->EvaluateResidualBlock(block, false, &cost, whitened.data(), nullptr)) continue;
    if (whitened.norm() > 4.0) ++report.content_outlier_count;
  }
}

Status Equations::ComputeSigmas(SolveReport& report) {
  // Held or not, the shared attitude error is part of what is not known of the absolute place.
  if (has_attitude_bias_) problem_->SetParameterBlockVariable(attitude_bias_.data());
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
  if (has_position_bias_) take(position_bias_.data(), 3);
  if (has_attitude_bias_) take(attitude_bias_.data(), 3);
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

void Equations::Store() {
  const auto delta = [](const std::array<double, kMapParameters>& d) {
    Eigen::Matrix3d matrix;
    matrix << 1.0 + d[0], d[1], d[2], d[3], 1.0 + d[4], d[5], d[6], d[7], 1.0;
    return matrix;
  };
  for (std::size_t s = 0; s < graph_.scenes.size(); ++s) {
    if (!InUse(static_cast<int>(s))) continue;
    state_.scenes[s].world_from_scene = Homography{world_from_unit_[s] * delta(scene_parameters_[s]) * unit_from_scene_[s]};
  }
  for (std::size_t f = 0; f < graph_.frames.size(); ++f) {
    FrameState& frame = state_.frames[f];
    if (frame.piece < 0) continue;
    const auto& p = frame_parameters_[f];
    if (frame.camera) {
      frame.camera->position_m += Eigen::Vector3d(p[0], p[1], p[2]);
      Eigen::Matrix3d step;
      ceres::AngleAxisToRotationMatrix(p.data() + 3, step.data());  // Column-major, as Eigen's.
      frame.camera->world_from_camera = frame.camera->world_from_camera * step;
      frame.world_from_sensor = GroundFromCamera(*frame.camera, graph_.input);
    } else if (!frame.gauge) {
      Eigen::Matrix3d sensor_from_unit;
      sensor_from_unit << sensor_.half_px, 0.0, sensor_.centre_x, 0.0, sensor_.half_px, sensor_.centre_y, 0.0, 0.0, 1.0;
      const Eigen::Matrix3d sensor_from_world = sensor_from_unit * delta(p) * FreeProjectionOf(static_cast<int>(f)).unit_from_world;
      Homography world_from_sensor{sensor_from_world.inverse()};
      if (world_from_sensor.Depth({sensor_.centre_x, sensor_.centre_y}) < 0.0) world_from_sensor.matrix *= -1.0;
      frame.world_from_sensor = world_from_sensor;
    }
  }
  for (int k = 0; k < 3; ++k) {
    state_.position_bias_m(k) = position_bias_[static_cast<std::size_t>(k)];
    state_.attitude_bias_rad(k) = attitude_bias_[static_cast<std::size_t>(k)];
  }
}

double VarianceFactor(const SolveReport& report) {
  std::vector<double> norms;
  for (const double norm2 : report.tie_norm2) {
    if (norm2 >= 0.0) norms.push_back(norm2);
  }
  if (norms.empty()) return 1.0;
  const auto middle = norms.begin() + static_cast<std::ptrdiff_t>(norms.size() / 2);
  std::nth_element(norms.begin(), middle, norms.end());
  return std::max(1.0, *middle / kMedianChi2With8);
}

}  // namespace

Result<SolveReport> Solve(const AlignGraph& graph, std::span<const ContentTie> content_ties, const AlignOptions& options, bool with_sigma,
                          const std::function<bool()>& progress, AlignState& state) {
  Equations equations(graph, content_ties, options, state);
  SolveReport report;
  TREM_ASSIGN_OR_RETURN(report.converged, equations.Minimise(progress));
  equations.EvaluateTies(1.0, report);
  report.variance_factor = VarianceFactor(report);
  equations.SetCauchy(report.variance_factor);
  TREM_ASSIGN_OR_RETURN(report.converged, equations.Minimise(progress));
  equations.EvaluateTies(report.variance_factor, report);
  equations.EvaluateContent(report);
  if (with_sigma) TREM_RETURN_IF_ERROR(equations.ComputeSigmas(report));
  equations.Store();
  return report;
}

}  // namespace trem::align
