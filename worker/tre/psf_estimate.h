#pragma once

#include <functional>
#include <span>
#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "worker/tre/engine_options.h"
#include "worker/tre/mapping_engine.h"

namespace trem {

// A short stretch of a sortie to try PSFs on: one ROI over successive frames.
struct PsfTrial {
  Roi roi;
  std::vector<FrameInput> frames;
};

// The width of the Gaussian part of the PSF that predicts the trials' frames best.
struct PsfEstimate {
  double sigma_px = 0.0;     // 0: nothing could be estimated, and `doubt` says why.
  double error_px = 0.0;     // Standard error.
  double noise_sigma = 0.0;  // Robust spread of the prediction's residuals at that width, internal grey levels; 0: none.
  std::string doubt;         // Empty: the estimate can be used.
};

// Runs the engine on every trial with some candidate widths. The score of a width is the one-step-ahead predictive likelihood: each frame is
// registered to the scene made of the frames before it, and the mean log of the residual's rms over the later frames falls as the model
// gets better. Too narrow a PSF lets the frames' noise through into the prediction; too wide a one asks for a scene that the frames
// contradict. The minimum of the parabola (in log sigma) through the best candidate and its neighbours is the estimate; its error is that
// of a jackknife over trials and halves of their frames, together with a floor for what simulations show beyond that.
//
// The scenes are regularised kTrialStructureWeight times as much as usual, which puts the minimum at or a little below the truth: a PSF that
// is too wide costs more than one that is too narrow. Cost: 4 to 7 runs of the engine a trial. Deterministic.
// kCancelled when `progress` (may be empty; called with the fraction done) says false.
Result<PsfEstimate> EstimatePsfSigma(std::span<const PsfTrial> trials, const EngineOptions& options, const std::function<bool(double)>& progress);

inline constexpr double kTrialStructureWeight = 1.7;

}  // namespace trem
