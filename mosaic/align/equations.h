#pragma once

#include <ceres/ceres.h>

#include <array>
#include <functional>
#include <map>
#include <memory>
#include <span>
#include <vector>

#include "mosaic/align/align_state.h"
#include "mosaic/align/residuals.h"
#include "mosaic/align/solver.h"

namespace trem::align {

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
  void EvaluateControl(SolveReport& report);
  Status ComputeSigmas(SolveReport& report);
  // Moves the solution into the state.
  void Store();

 private:
  // What all frames with telemetry of one recording share.
  struct SharedErrors {
    std::array<double, 3> position{};  // m.
    std::array<double, 3> attitude{};  // rad, about the camera's axes.
    bool has_attitude = false;         // Some frame has a camera.
  };

  // Whether a recording's cameras look along directions more than 60 degrees apart.
  bool HeadingsDiffer(std::uint32_t recording) const;
  SharedErrors& SharedOf(const FrameAnchor& anchor);
  CameraProjection CameraProjectionOf(int frame) const;
  FreeProjection FreeProjectionOf(int frame) const;
  // A cell of a scene without what relief shifts it by, on the unit square.
  Eigen::Vector2d UnitFromShown(int scene, const Eigen::Vector2d& shown) const;
  // Standard deviation of what a tie's view leaves unexplained, sensor px.
  double FloorPx(std::size_t tie) const;
  void AddFrames();
  void AddScenes();
  void AddAnchorPriors();
  void AddTies();
  void AddContentTies(std::span<const ContentTie> content_ties);
  void AddControl();
  void AddSharedPriors();
  // Holds shared errors that nothing in the data tells from others.
  void HoldWhatCannotBeSeen(bool has_content_ties);
  bool InUse(int scene) const { return state_.scenes[static_cast<std::size_t>(scene)].piece >= 0; }

  const AlignGraph& graph_;
  const AlignOptions& options_;
  AlignState& state_;
  SensorFrame sensor_;
  ceres::LossFunctionWrapper tie_loss_{nullptr, ceres::TAKE_OWNERSHIP};
  ceres::LossFunctionWrapper content_loss_{nullptr, ceres::TAKE_OWNERSHIP};
  ceres::LossFunctionWrapper control_loss_{nullptr, ceres::TAKE_OWNERSHIP};
  std::vector<std::array<double, kMapParameters>> frame_parameters_;  // Cameras use the first six.
  std::vector<std::array<double, kMapParameters>> scene_parameters_;
  std::map<std::uint32_t, SharedErrors> shared_;  // By recording; addresses stay.
  std::array<double, kLensParameters> lens_{};
  std::vector<Eigen::Matrix3d> unit_from_scene_;
  std::vector<Eigen::Matrix3d> world_from_unit_;
  std::vector<ceres::ResidualBlockId> tie_blocks_;  // nullptr: unused.
  std::vector<ceres::ResidualBlockId> content_blocks_;
  std::vector<int> content_tie_of_block_;               // Index into the content ties.
  std::vector<ceres::ResidualBlockId> control_blocks_;  // Parallel to AlignInput::control; nullptr: unused.
  std::unique_ptr<ceres::Problem> problem_;
  bool has_lens_ = false;  // Some frame has a camera.
};

}  // namespace trem::align
