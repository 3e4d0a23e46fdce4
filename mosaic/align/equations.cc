#include "mosaic/align/equations.h"

#include <ceres/normal_prior.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <string>

namespace trem::align {

Whitener8 TieWhitener(const CornerCovariance& corner_covariance_px2, double floor_px) {
  const bool projective = corner_covariance_px2.rows() == 8;
  // Tie points in the order of RoiCorners; their coordinates along the upper and left side.
  constexpr double kNear = 0.5 - 0.5 / std::numbers::sqrt3, kFar = 1.0 - kNear;
  constexpr double kAlong[4] = {kNear, kFar, kFar, kNear};
  constexpr double kDown[4] = {kNear, kNear, kFar, kFar};
  Eigen::Matrix<double, 8, Eigen::Dynamic> points_from_own = Eigen::MatrixXd::Zero(8, corner_covariance_px2.rows());
  for (int k = 0; k < 4; ++k) {
    // The lower right corner: of a projective view by itself, of an affine one by extrapolation.
    const double own = projective ? kAlong[k] * kDown[k] : 0.0;
    const double weights[4] = {1.0 - kAlong[k] - kDown[k] + own, kAlong[k] - own, kDown[k] - own, own};
    for (int c = 0; c < corner_covariance_px2.rows() / 2; ++c) {
      points_from_own.block<2, 2>(2 * k, 2 * c) = weights[c] * Eigen::Matrix2d::Identity();
    }
  }
  Whitener8 covariance = points_from_own * corner_covariance_px2 * points_from_own.transpose();
  covariance.diagonal().array() += floor_px * floor_px;
  const Eigen::LLT<Whitener8> llt(covariance);
  TREM_CHECK(llt.info() == Eigen::Success);
  return llt.matrixL().solve(Whitener8::Identity());
}

namespace {

constexpr double kTieDegrees = 8.0;

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

ceres::Problem::Options BorrowedLosses() {
  ceres::Problem::Options options;
  options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  return options;
}

}  // namespace

Equations::Equations(const AlignGraph& graph, std::span<const ContentTie> content_ties, const AlignOptions& options, AlignState& state)
    : graph_(graph), options_(options), state_(state), problem_(std::make_unique<ceres::Problem>(BorrowedLosses())) {
  sensor_ = {0.5 * (graph.input.width_px - 1), 0.5 * (graph.input.height_px - 1),
             0.5 * std::max(graph.input.width_px, graph.input.height_px)};
  frame_parameters_.resize(graph.frames.size());
  scene_parameters_.resize(graph.scenes.size());
  for (auto& parameters : frame_parameters_) parameters.fill(0.0);
  for (auto& parameters : scene_parameters_) parameters.fill(0.0);
  lens_ = {state.lens.log_focal, state.lens.k1};
  SetHuber();
  problem_->AddParameterBlock(lens_.data(), kLensParameters);
  AddFrames();
  AddScenes();
  AddAnchorPriors();
  AddSharedPriors();
  AddTies();
  AddContentTies(content_ties);
  AddControl();
  HoldWhatCannotBeSeen(!content_ties.empty());
}

void Equations::HoldWhatCannotBeSeen(bool has_content_ties) {
  const bool controlled = std::any_of(control_blocks_.begin(), control_blocks_.end(), [](const auto* block) { return block != nullptr; });
  // A boresight error shows between legs of different headings that meet, and at control points. On one leg it shows only in the faint
  // perspective of small fields of view and in the bias of feature positions, where a few thousandths of a pixel pass for some hundredths
  // of a degree: there telemetry is believed as it is.
  const Boresight boresight = graph_.input.boresight;
  for (auto& [recording, shared] : shared_) {
    const bool seen = controlled || (has_content_ties && HeadingsDiffer(recording));
    if (shared.has_attitude && (boresight == Boresight::kHeld || (boresight == Boresight::kWhereSeen && !seen)))
      problem_->SetParameterBlockConstant(shared.attitude.data());
  }
  const bool focal = has_lens_ && graph_.input.focal_sigma > 0.0;
  const bool distortion = has_lens_ && graph_.input.estimate_distortion;
  if (!focal && !distortion) {
    problem_->SetParameterBlockConstant(lens_.data());
  } else if (!focal || !distortion) {
    problem_->SetManifold(lens_.data(), new ceres::SubsetManifold(kLensParameters, {focal ? 1 : 0}));
  }
}

Equations::SharedErrors& Equations::SharedOf(const FrameAnchor& anchor) {
  const auto [found, is_new] = shared_.try_emplace(anchor.recording);
  const auto known = state_.biases.find(anchor.recording);
  for (std::size_t k = 0; is_new && known != state_.biases.end() && k < 3; ++k) {
    found->second.position[k] = known->second.position_m(static_cast<int>(k));
    found->second.attitude[k] = known->second.attitude_rad(static_cast<int>(k));
  }
  return found->second;
}

bool Equations::HeadingsDiffer(std::uint32_t recording) const {
  constexpr double kCosine60Deg = 0.5;
  std::optional<Eigen::Vector2d> first;
  for (std::size_t f = 0; f < state_.frames.size(); ++f) {
    const FrameState& frame = state_.frames[f];
    const int anchor = graph_.frames[f].anchor;
    if (!frame.camera || anchor < 0 || graph_.input.anchors[static_cast<std::size_t>(anchor)].recording != recording) continue;
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
  control_loss_.Reset(new ceres::HuberLoss(2.0), ceres::TAKE_OWNERSHIP);
}

void Equations::SetCauchy(double tie_factor) {
  const double scale = std::sqrt(2.0 * kTieDegrees * tie_factor);
  tie_loss_.Reset(new ceres::ScaledLoss(new ceres::CauchyLoss(scale), 1.0 / tie_factor, ceres::TAKE_OWNERSHIP), ceres::TAKE_OWNERSHIP);
  content_loss_.Reset(new ceres::CauchyLoss(2.0), ceres::TAKE_OWNERSHIP);
  control_loss_.Reset(new ceres::CauchyLoss(3.0), ceres::TAKE_OWNERSHIP);
}

CameraProjection Equations::CameraProjectionOf(int frame) const {
  const AlignInput& input = graph_.input;
  const double level_m = input.ground ? 0.5 * (input.ground->lowest_m() + input.ground->highest_m()) : input.ground_z_m;
  return {*state_.frames[static_cast<std::size_t>(frame)].camera, sensor_, {input.ground.get(), level_m}};
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
    // One half size of freedom: negligible beside any tie; keeps a scene that a single weak view holds from being singular. A thousand of
    // them for the place, which all scenes share with telemetry's error: priors of thousands of scenes add up there, and the stated
    // standard error sank.
    Eigen::MatrixXd freedom = Eigen::MatrixXd::Identity(kMapParameters, kMapParameters);
    freedom(2, 2) = freedom(5, 5) = 1e-3;
    problem_->AddResidualBlock(new ceres::NormalPrior(freedom, Eigen::VectorXd::Zero(kMapParameters)), nullptr, parameters);
  }
}

Eigen::Vector2d Equations::UnitFromShown(int scene, const Eigen::Vector2d& shown) const {
  const auto s = static_cast<std::size_t>(scene);
  return (unit_from_scene_[s] * Unshifted(state_.scenes[s].shifts, shown).homogeneous()).head<2>();
}

void Equations::AddAnchorPriors() {
  const AlignInput& input = graph_.input;
  for (std::size_t f = 0; f < graph_.frames.size(); ++f) {
    const FrameState& frame = state_.frames[f];
    if (graph_.frames[f].anchor < 0 || frame.piece < 0) continue;
    const FrameAnchor& anchor = input.anchors[static_cast<std::size_t>(graph_.frames[f].anchor)];
    const TelemetrySigmas sigmas = input.SigmasOf(anchor.recording);
    const double white_m = std::max(options_.position_white_min_m, options_.position_white_fraction * sigmas.position_m);
    SharedErrors& shared = SharedOf(anchor);
    if (frame.camera) {
      const Camera telemetry = CameraFromAnchor(anchor);
      const Eigen::Matrix3d rotation = telemetry.world_from_camera.transpose() * frame.camera->world_from_camera;
      auto* const cost = new ceres::AutoDiffCostFunction<CameraPrior, 6, kCameraParameters, 3, 3>(
          new CameraPrior{frame.camera->position_m - telemetry.position_m, Eigen::Quaterniond(rotation),
                          std::hypot(white_m, anchor.position_extra_m), std::hypot(sigmas.attitude_rad, anchor.attitude_extra_rad)});
      problem_->AddResidualBlock(cost, nullptr, frame_parameters_[f].data(), shared.position.data(), shared.attitude.data());
      shared.has_attitude = true;
      has_lens_ = true;
    } else {
      const double gsd_m = std::exp(frame.log_scale0);
      const double right = input.width_px - 0.5, bottom = input.height_px - 0.5;
      auto* const cost = new ceres::AutoDiffCostFunction<CornerPrior, 8, kMapParameters, 3>(new CornerPrior{
          FreeProjectionOf(static_cast<int>(f)),
          *anchor.corners,
          {Eigen::Vector2d(-0.5, -0.5), Eigen::Vector2d(right, -0.5), Eigen::Vector2d(right, bottom), Eigen::Vector2d(-0.5, bottom)},
          sigmas.position_m / gsd_m});
      problem_->AddResidualBlock(cost, nullptr, frame_parameters_[f].data(), shared.position.data());
    }
  }
}

void Equations::AddSharedPriors() {
  const AlignInput& input = graph_.input;
  const auto add_prior = [this](double sigma, double* bias) {
    problem_->AddResidualBlock(new ceres::NormalPrior(Eigen::MatrixXd::Identity(3, 3) / sigma, Eigen::VectorXd::Zero(3)), nullptr, bias);
  };
  for (auto& [recording, shared] : shared_) {
    const TelemetrySigmas sigmas = input.SigmasOf(recording);
    add_prior(sigmas.position_m, shared.position.data());
    if (shared.has_attitude) add_prior(sigmas.attitude_rad, shared.attitude.data());
  }
  // Distortions of lenses are a few per cent at the edge of the field.
  constexpr double kDistortionSigma = 0.3;
  Eigen::MatrixXd lens = Eigen::MatrixXd::Zero(kLensParameters, kLensParameters);
  lens(0, 0) = input.focal_sigma > 0.0 ? 1.0 / input.focal_sigma : 1.0;
  lens(1, 1) = 1.0 / kDistortionSigma;
  problem_->AddResidualBlock(new ceres::NormalPrior(lens, Eigen::VectorXd::Zero(kLensParameters)), nullptr, lens_.data());
}

double Equations::FloorPx(std::size_t tie) const { return std::hypot(graph_.ties[tie].floor_px, state_.tie_relief_px[tie]); }

void Equations::AddTies() {
  tie_blocks_.assign(graph_.ties.size(), nullptr);
  for (std::size_t t = 0; t < graph_.ties.size(); ++t) {
    const Tie& tie = graph_.ties[t];
    const auto f = static_cast<std::size_t>(tie.frame);
    const auto s = static_cast<std::size_t>(tie.scene);
    if (state_.tie_unusable[t] || !InUse(tie.scene) || state_.frames[f].piece < 0) continue;
    const ChainView& view = graph_.ViewOf(tie);
    const std::array<Eigen::Vector2d, 4> u = TiePoints(graph_.SegmentOf(tie).roi_in_sensor);
    std::array<Eigen::Vector2d, 4> xi;
    for (std::size_t k = 0; k < 4; ++k) xi[k] = UnitFromShown(tie.scene, view.scene_from_sensor * u[k]);
    const Whitener8 whitener = TieWhitener(view.corner_covariance_px2, FloorPx(t));
    // The one frame of a scene is the scene, perspective included, which nothing else would hold.
    const bool affine_part = view.corner_covariance_px2.rows() == 6 && graph_.scenes[s].ties.size() > 1;
    ceres::CostFunction* cost = nullptr;
    if (state_.frames[f].camera) {
      cost = new ceres::AutoDiffCostFunction<TieResidual<CameraProjection>, 8, kCameraParameters, kMapParameters, kLensParameters>(
          new TieResidual<CameraProjection>{CameraProjectionOf(tie.frame), world_from_unit_[s], xi, u, whitener, affine_part});
    } else {
      cost = new ceres::AutoDiffCostFunction<TieResidual<FreeProjection>, 8, kMapParameters, kMapParameters, kLensParameters>(
          new TieResidual<FreeProjection>{FreeProjectionOf(tie.frame), world_from_unit_[s], xi, u, whitener});
    }
    tie_blocks_[t] = problem_->AddResidualBlock(cost, &tie_loss_, frame_parameters_[f].data(), scene_parameters_[s].data(), lens_.data());
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
              new ContentResidual{world_from_unit_[a], world_from_unit_[b], UnitFromShown(tie.scene_a, tie.x_in_a[k]),
                                  UnitFromShown(tie.scene_b, tie.x_in_b[k]), whitened_from_world}),
          &content_loss_, scene_parameters_[a].data(), scene_parameters_[b].data()));
      content_tie_of_block_.push_back(static_cast<int>(&tie - content_ties.data()));
    }
  }
}

void Equations::AddControl() {
  const AlignInput& input = graph_.input;
  control_blocks_.assign(input.control.size(), nullptr);
  for (std::size_t c = 0; c < input.control.size(); ++c) {
    const ControlObservation& control = input.control[c];
    const auto found = std::lower_bound(graph_.frames.begin(), graph_.frames.end(), control.frame,
                                        [](const FrameNode& node, std::uint32_t frame) { return node.frame < frame; });
    if (control.held_out || found == graph_.frames.end() || found->frame != control.frame) continue;
    const auto f = static_cast<std::size_t>(found - graph_.frames.begin());
    const FrameState& frame = state_.frames[f];
    // Without telemetry the world is pixels of a reference frame, which a survey knows nothing of.
    if (frame.piece < 0 || !state_.piece_anchored[static_cast<std::size_t>(frame.piece)]) continue;
    const double gsd_m = std::sqrt(std::abs(frame.world_from_sensor.LinearisedAt(control.u).linear.determinant()));
    const double sigma_px = std::hypot(input.control_sigma_px, input.control_sigma_m / gsd_m);
    ceres::CostFunction* cost = nullptr;
    if (frame.camera) {
      // A point that the camera can't see, far off as it may be, must not stop the solve.
      Eigen::Vector2d seen;
      if (!CameraProjectionOf(static_cast<int>(f)).See<double>(frame_parameters_[f].data(), lens_.data(), control.x_in_world, &seen))
        continue;
      cost = new ceres::AutoDiffCostFunction<ControlResidual<CameraProjection>, 2, kCameraParameters, kLensParameters>(
          new ControlResidual<CameraProjection>{CameraProjectionOf(static_cast<int>(f)), control.x_in_world, control.u, sigma_px});
    } else {
      cost = new ceres::AutoDiffCostFunction<ControlResidual<FreeProjection>, 2, kMapParameters, kLensParameters>(
          new ControlResidual<FreeProjection>{FreeProjectionOf(static_cast<int>(f)), control.x_in_world, control.u, sigma_px});
    }
    control_blocks_[c] = problem_->AddResidualBlock(cost, &control_loss_, frame_parameters_[f].data(), lens_.data());
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

void Equations::Store() {
  state_.lens = {lens_[0], lens_[1]};
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
      frame.world_from_sensor = GroundFromCamera(*frame.camera, state_.lens, graph_.input);
    } else if (!frame.gauge) {
      Eigen::Matrix3d sensor_from_unit;
      sensor_from_unit << sensor_.half_px, 0.0, sensor_.centre_x, 0.0, sensor_.half_px, sensor_.centre_y, 0.0, 0.0, 1.0;
      const Eigen::Matrix3d sensor_from_world = sensor_from_unit * delta(p) * FreeProjectionOf(static_cast<int>(f)).unit_from_world;
      Homography world_from_sensor{sensor_from_world.inverse()};
      if (world_from_sensor.Depth({sensor_.centre_x, sensor_.centre_y}) < 0.0) world_from_sensor.matrix *= -1.0;
      frame.world_from_sensor = world_from_sensor;
    }
  }
  for (const auto& [recording, shared] : shared_) {
    state_.biases[recording] = {Eigen::Vector3d(shared.position.data()), Eigen::Vector3d(shared.attitude.data())};
  }
}

}  // namespace trem::align
