#pragma once

#include <array>
#include <functional>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "worker/tre/automatic_regularisation.h"
#include "worker/tre/frame_residual.h"
#include "worker/tre/information_update.h"
#include "worker/tre/kept_frames.h"
#include "worker/tre/mapping_engine.h"
#include "worker/tre/mover_mask.h"
#include "worker/tre/place_field.h"
#include "worker/tre/scene_buffer.h"
#include "worker/tre/uncertainty.h"
#include "worker/tre/update_scheme.h"

namespace trem {

// One scene plane and the frames registered to it. Cell = ratio * (sensor - roi corner) at the first frame, so cell centres lie on
// sensor pixel centres for every ratio.
//
// Covariance of a view. A frame's noise, projected on what moving the frame would change, is an error of its place; its covariance is
// C = (J'J / sigma^2)^-1, the Cramer-Rao bound. Averaging frames does not take it out of the scene: each is first aligned to what is
// there, after which its projection equals the scene's. So the scene lies where the first frame's noise put it, off the plane that the
// first frame's view defines by an error of covariance S_1 = C_1, and every later view has its own error and this common one:
//
//   cov(view t) = own_t + S_t
//
// own_t: Registration::corner_covariance of worker/registration. S_t is what the scene's error beneath the frame, a field over its plane,
// makes of the view; PlaceField follows it from frame to frame: where cells have been seen unequally often, and where new ground is
// placed by the views that extend the scene, frames' noise is written into it and stays.
class Segment {
 public:
  using Emit = std::function<Status(const SceneSnapshot&)>;

  // What becomes of the part of the scene plane in memory when frames show more than it holds.
  enum class Extent {
    kMoves,  // It grows and moves on with the ROI, emitting snapshots.
    kFixed,  // It stays: the first frame's ROI with a margin, so that frames of a moving target pile up on it.
  };
  // Where a frame is expected, when the caller knows better than Predict.
  struct Expectation {
    ViewPrior prior;
    double motion_px_max = 20.0;
    std::vector<View> candidates;
  };

  Segment(const Roi& roi, const SeparablePsf& psf, const EngineOptions& options, std::uint64_t segment_id, Extent extent = Extent::kMoves);

  // The first frame: fills the scene with its bicubic enlargement and improves it. Its view is the gauge: gain 1, offset 0.
  Registration Begin(const FrameInput& frame, double noise_sigma);
  // Registers a frame to the scene's prediction; the scene is not changed.
  JudgedRegistration RegisterFrame(const FrameInput& frame, double noise_sigma);
  JudgedRegistration RegisterFrame(const FrameInput& frame, double noise_sigma, const Expectation& expectation);
  // Splats a registered frame and improves the scene; emits a snapshot first when the ROI has moved off the buffer.
  Status AddFrame(const FrameInput& frame, const Registration& registration, double noise_sigma, const Emit& emit);
  // A frame that was not registered: its motion still counts for where the next one is expected.
  void SkipFrame(const FrameInput& frame);
  // Whether the frame shows other ground than the scene does, as its measured motion has it: less of its ROI than registering needs lies
  // over the scene, or, at worst, would lie there if the motion were off by as much as is tolerated. False where the motion is not known.
  enum class Expected { kAsMeasured, kAtWorst };
  bool HasMovedOff(const FrameInput& frame, Expected expected) const;
  // Emits the last snapshot.
  Status End(double noise_sigma, const Emit& emit);

  // Views found again with AddFrame's frame, to replace those reported before; empty but once a segment.
  std::vector<ChainEntry> TakeRevised() { return std::exchange(revised_, {}); }

  int frame_count() const { return frame_count_; }
  const View& view() const { return view_; }  // Of the last registered frame.
  // What the last added frame left of the prediction.
  const FrameResidual& residual() const { return residual_; }
  // Pixels of all frames that were masked as moving.
  long long masked() const { return masked_; }
  bool has_emitted() const { return has_emitted_; }
  // What the sensor would see of the scene in `view` on the pixels of `roi`, with the view's gain and offset; NaN where the scene is not
  // settled enough to register to.
  Image<float> PredictFrame(const View& view, const Roi& roi) const;

 private:
  // Where the frame's pixels lie in the sensor.
  Roi RoiOf(const FrameInput& frame) const { return frame.roi.value_or(roi_); }
  // Cells that the view's ROI covers, with the PSF's radius around them.
  Roi Footprint(const PlanarMap& scene_from_sensor) const;
  // The cells that a frame updates.
  Roi RegionOf(const View& view) const { return extent_ == Extent::kFixed ? buffer_.extent : Footprint(view.scene_from_sensor); }
  // Where the next frame is expected: whole-image motion when known, else constant velocity.
  ViewPrior Predict(const FrameInput& frame) const;
  // Constant velocity: p(A_t | A_t-1) of tre.dynamics_sigma_px.
  ViewPrior PredictByDynamics() const;
  // How far a corner may end from where it was expected [sensor px].
  double MotionTolerancePx(const FrameInput& frame, const PlanarMap& expected) const;
  Reference ReferenceNow(float seen_min) const;
  // What the scene beneath a registered frame shows, and what its own error adds to the covariance of the frame's view.
  struct Placed {
    int frame_index = 0;
    double noise_sigma = 0.0;
    View view;
    PlaceField::Texture texture;
    CornerMatrix covariance;
  };
  Placed PlaceOf(const FrameInput& frame, const Registration& registration, double noise_sigma) const;
  // The same, from when the frame was registered if it was the last one.
  Placed TakePlaced(const FrameInput& frame, const Registration& registration, double noise_sigma);
  // Once a few frames have resolved what one frame aliases, the first ones are registered again, the first one included; all are moved so
  // that the first one's view is the plane's again, and the scene is accumulated afresh. Without, the plane would keep what the second
  // and third frame's registration to a single frame's scene was off by.
  void KeepForRevisit(const FrameInput& frame, const Image<float>* weights, const Registration& registration, double noise_sigma);
  void Revisit(double noise_sigma);
  // Frames that must have seen a cell for frames to be registered to it.
  float SeenMin() const;
  // Gives cells of `region` that no frame has measured yet their first value and makes the prediction on `region`; rectangles that hold
  // these cells.
  std::vector<Roi> FillNew(const FrameInput& frame, const View& view, const Roi& region);
  // Further steps on the sides of `region` by which it has grown beyond the last one by a sensor pixel since they were last taken there.
  void IterateNewGround(const Roi& region, const std::vector<Roi>& filled, StructureWeight weight);
  void Update(const FrameInput& frame, const Observation& observation, const View& view, int iterations);
  // Judges what the frame leaves of the prediction; the frame's weights without what moves (null: all 1), and ground that showed a mover
  // is made free to be made anew.
  const Image<float>* MaskMovers(const FrameInput& frame, double noise_sigma);
  // `iterations` steps on `region` under the automatic weight times the user's factor.
  void Iterate(const Roi& region, int iterations, StructureWeight weight);
  // Registers the frames that the scheme keeps, but the last, to the present scene.
  void ReviseKeptFrames();
  // Factor on the accumulated information of the cells that this frame sees, from how long the ROI dwells on them.
  double Forgetting() const;
  // For how many frames the ROI covers a piece of ground at its present progress.
  double DwellFrames() const;
  Status EmitSnapshot(double noise_sigma, const Emit& emit);
  // The scene that the kept frames lead to: samples accumulated anew, weight found by frames held out, iterations to convergence. A copy:
  // later frames go on from the scene that they were registered to.
  SceneBuffer Polished(double noise_sigma);
  // The standard deviations and residuals of the snapshot that was `made`.
  void AddUncertainty(const SceneBuffer& made, double noise_sigma, SceneSnapshot* snapshot);

  Roi roi_;
  EngineOptions options_;
  std::uint64_t segment_id_;
  Extent extent_;
  int margin_;
  InformationUpdate update_;
  AutomaticRegularisation regularisation_;
  std::unique_ptr<UpdateScheme> scheme_;  // Null: the information update.
  std::optional<KeptFrames> kept_;        // The information update's.
  StructureWeight weight_;                // As of the last count of cells, without the user's factor.
  StructureWeight emitted_weight_;        // That the last snapshot was made with, without the user's factor.
  double emitted_log_factor_;             // On the present automatic weight, found by frames held out.
  SceneBuffer buffer_;
  Image<float> continued_;                                  // The frame with its holes continued.
  ResidualMap residuals_;                                   // Not kept up without EngineOptions::uncertainty.
  View view_;                                               // Of the last registered frame.
  PlanarMap previous_from_current_;                         // Last measured motion, in sensor pixels.
  PlanarMap lost_from_current_;                             // Motion of frames skipped since then.
  bool lost_motion_known_ = true;                           // Whether all of that was measured.
  CornerMatrix covariance_;                                 // Of view_, without the scene's, 6 x 6 or 8 x 8.
  PlaceField place_;                                        // Of the scene's place on its plane: S above.
  std::optional<Placed> placed_;                            // Of the frame that was registered last, until it is added.
  CornerMatrix velocity_covariance_;                        // Of previous_from_current_, as a corner displacement a frame.
  Eigen::Vector2d progress_px_ = Eigen::Vector2d::Zero();   // Slow mean of the ROI's motion over the ground, sensor px a frame.
  std::vector<std::pair<FrameInput, Registration>> early_;  // Until the revisit.
  std::vector<ChainEntry> revised_;
  Roi last_region_;  // Footprint of the last frame: where the prediction is that of the present scene.
  std::array<double, 4> fresh_lines_ =
      {};                            // Of cells that each side (left, right, top, bottom) has brought in and that were not iterated yet.
  double pending_forgetting_ = 1.0;  // Of frames, that is not applied to the buffer yet.
  int frame_count_ = 0;
  int skipped_ = 0;
  FrameResidual residual_;
  MoverMask movers_;
  Image<float> weights_;  // Of the frame, without what moves.
  long long masked_ = 0;  // Pixels so far.
  bool has_emitted_ = false;
  int first_unemitted_ = 0;
  int first_frame_ = 0;
  int last_added_ = 0;
};

}  // namespace trem
