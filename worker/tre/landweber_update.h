#pragma once

#include <vector>

#include "worker/sensor/blur.h"
#include "worker/tre/update_scheme.h"

namespace trem {

struct LandweberOptions {
  int window = 8;             // Frames kept, 1 .. 64. 1 is recursive: each frame is used once and then lives in the scene alone.
  double huber_sigmas = 3.0;  // Residuals further out count as this much, where the scene is known.
  double relaxation = 1.9;    // Step length over 1 / bound of the curvature; below 2 every step descends.
};

// The whole-scene gradient of the year-2 scheme: steps on
//
//   sum_t sum_u w_t(u) rho(g_t (C_t B S)(u) + o_t - I_t(u)) + kappa lambda * prior(S)
//
// over the frames of the window, with the sensor model itself: B the PSF, C_t bicubic sampling at the view, no splatting (ForwardOperator
// states A_t = C_t B). One step length for all cells, relaxation / L with L a bound on the curvature: the largest cell of
// |B|' |C|' w |C| |B| 1, plus the prior's. kappa = frames in the window / frames that have seen the region, at most 1: the prior counts
// once for all frames, not once a window. Cost a step: one blur and its adjoint, and 32 multiply-adds a pixel and frame.
// Source: Landweber, Am. J. Math. 73, 1951; Irani & Peleg, CVGIP 53, 1991.
class LandweberUpdate : public UpdateScheme {
 public:
  LandweberUpdate(const Psf& psf, const LandweberOptions& options) : blur_(psf), options_(options) {}

  void AddFrame(int frame_index, const Observation& observation, const View& view) override;
  void Iterate(const Roi& region, int iterations, const StructurePrior& prior, float lambda, SceneBuffer* buffer) override;
  bool remembers() const override { return false; }
  std::span<KeptFrame> kept_frames() override { return frames_; }

 private:
  // A bound on the data term's curvature over the cells of `inner` [buffer].
  float CurvatureBound(const Roi& inner, const SceneBuffer& buffer);
  // splatted_ = sum_t C_t' w rho'(residual of blurred_) for the pixels whose support touches `context` [buffer].
  void SplatResiduals(const Roi& context, const SceneBuffer& buffer);

  Blur blur_;
  LandweberOptions options_;
  std::vector<KeptFrame> frames_;
  Image<float> blurred_;
  Image<float> splatted_;
  Image<float> gradient_;
};

}  // namespace trem
