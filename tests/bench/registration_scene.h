#pragma once

#include <array>
#include <string>
#include <vector>

#include "tests/support/rendered_sequence.h"
#include "worker/registration/gauss_newton.h"

namespace trem::bench {

// A settled scene and frames of it at known views, for benches of registration. The frames are rendered from the truth by dense quadrature
// (tests/support/rendered_sequence.h).
struct SceneOptions {
  int width = 151;  // Of the ROI [sensor px].
  int height = 151;
  double noise_sigma = 2.0;
  int margin_px = 60;  // Scene around the ROI at the nominal view.
  std::string truth;   // Picture; empty: procedural.
  std::uint64_t seed = 1;
  // 0: the reference is the truth blurred by the engine's own point spread function, what a scene converges to. More: it is the scene that
  // the engine's update makes of so many noisy frames at their true views.
  int settle_frames = 0;
};

struct Frame {
  View truth;
  Image<float> pixels;
};

class RegistrationScene {
 public:
  // Exits with a message when the picture cannot be used.
  explicit RegistrationScene(const SceneOptions& options);

  const Roi& roi() const { return roi_; }
  View Nominal() const;
  // Scene cells within `margin_px` of the footprint of the ROI at `view`; a copy.
  struct Window {
    Image<float> prediction;
    Image<float> seen;
    int x0 = 0;
    int y0 = 0;
    Reference reference() const { return {&prediction, &seen, x0, y0, 3, 0.75F}; }
  };
  Window WindowAround(const View& view, double margin_px) const;
  // The nominal view displaced by `d`, with a gain and an offset that differ a little; `stream` names the noise.
  Frame Render(const CornerVector& d, std::uint64_t stream) const;
  Observation Observe(const Frame& frame) const { return {&frame.pixels, roi_, options_.noise_sigma}; }
  ViewPrior PriorAbout(const View& mean, double sigma_px) const;

 private:
  void Settle();

  SceneOptions options_;
  testing::SequenceOptions sequence_;
  Roi roi_;
  Image<float> truth_;
  Image<float> prediction_;
  Image<float> seen_;
};

// Displacements of the three corners by a translation [px] and a rotation about the ROI's centre.
CornerVector RigidDisplacement(const Roi& roi, const Eigen::Vector2d& shift_px, double rotation_rad);

// The peer: cv::findTransformECC, affine, frame as the template, from `start`. False when it gave up.
bool RegisterEcc(const Observation& observation, const Reference& reference, const View& start, View* view);

// Largest error of the four corners [sensor px].
double ErrorPx(const View& view, const View& truth, const Roi& roi);

// Value below which `part` of `values` lie.
double Quantile(std::vector<double> values, double part);

double NowMs();
// CPU time of the calling thread.
double CpuMs();

}  // namespace trem::bench
