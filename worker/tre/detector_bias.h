#pragma once

#include "mosaic/base/image.h"
#include "worker/tre/engine_options.h"
#include "worker/tre/frame_residual.h"

namespace trem {

// The fixed pattern of a detector: a bias per sensor pixel of the ROI, estimated together with the scene from what the frames leave of
// the prediction,
//
//   frame(u) = gain * (B S)(view u) + offset + bias(u) + noise.
//
// The scene moves over the detector, the bias does not: that separates them, and nothing else does. So frames count only when the view
// has moved on, and the gauge is fixed: the bias has no component that gain, offset or the scene's coarse structure could carry (its mean
// over 17 x 17 pixels is zero everywhere). What does not vary along a straight path of the view stays with the scene.
//
// Each pixel's estimate is a weighted mean of its residuals, those that a scene of few frames or strong contrast makes uncertain
// weighing less, pulled to zero by a Gaussian prior whose sigma is the pattern's own spread. Two halves of the frames, taken by turns of
// 2 px of motion, are kept apart: what they agree in is the pattern (an unbiased estimate of its variance), what they do not is noise.
// Source: Hardie & Droege, EURASIP J. Adv. Signal Process. 2007/89354 (joint estimate of scene and bias).
class DetectorBias {
 public:
  DetectorBias(int width, int height, Correction mode);

  // Learns from a registered frame from which bias() had been subtracted if active(). `centre`: where the ROI's centre lies
  // in the scene plane, in sensor pixels; scene planes of different segments are told apart by BreakTrack().
  // Returns how far the view has moved since the frame before [sensor px].
  double Learn(const FrameResidual& residual, const Eigen::Vector2d& centre, double noise_sigma);
  // The next frame's centre has nothing to do with the ones before.
  void BreakTrack() { has_centre_ = false; }
  // The frames so far are going to be seen again, with a better scene: what they said counts a quarter.
  void Revisit();

  bool active() const { return active_; }
  const Image<float>& bias() const { return bias_; }
  double sigma() const { return sigma_; }  // Of the pattern, internal grey levels; 0: none found.
  // Whether the view has moved far enough over the detector to tell it from the scene.
  bool separable() const { return travel_px_ >= kTravelMin; }

  static constexpr double kTravelMin = 6.0;  // Sensor pixels.

 private:
  void Estimate(double noise_sigma);

  Correction mode_;
  Image<float> weight_[2];
  Image<float> weighted_[2];
  Image<float> bias_;
  bool active_ = false;
  double sigma_ = 0.0;
  bool has_centre_ = false;
  Eigen::Vector2d last_centre_ = Eigen::Vector2d::Zero();
  Eigen::Vector2d turn_start_ = Eigen::Vector2d::Zero();
  double travel_px_ = 0.0;
  int half_ = 0;
  int turns_ = 0;
  int learned_ = 0;
};

// Subtracts the mean over (2 reach + 1)^2 pixels, smaller at the border; NaN pixels take no part and become 0.
void RemoveLocalMean(int reach, Image<float>* image);

}  // namespace trem
