#pragma once

#include <cmath>
#include <cstdint>
#include <numbers>
#include <vector>

#include "mosaic/base/rng.h"
#include "tests/support/rendered_sequence.h"
#include "worker/registration/gauss_newton.h"
#include "worker/sensor/bicubic.h"
#include "worker/sensor/blur.h"

namespace trem::testing {

// A scene whose prediction is known exactly, and frames that are samples of it plus noise: what registration's own model says, so that
// errors and covariances can be held against theory.
struct SyntheticScene {
  static constexpr int kRatio = 3;
  static constexpr float kSeen = 1000.0F;  // So often that the weight n / (n + 1) is 1.

  Roi roi;
  Image<float> prediction;
  Image<float> seen;
  int x0 = -60;
  int y0 = -60;
  double noise_sigma = 2.0;

  explicit SyntheticScene(int roi_px, std::uint64_t seed = 1)
      : roi{10, 20, 10 + roi_px, 20 + roi_px}, prediction(kRatio * roi_px + 120, kRatio * roi_px + 120), seen(prediction) {
    Blur(*MakePsf({0.55, 0.9}, kRatio)).Apply(ProceduralTruth(prediction.width(), prediction.height(), seed), &prediction);
    for (float& cell : seen.pixels()) cell = kSeen;
  }

  Reference reference() const { return {&prediction, &seen, x0, y0, kRatio, 0.75F}; }
  Observation Observe(const Image<float>& frame) const { return {&frame, roi, noise_sigma}; }

  // Cell = 3 * (sensor - roi corner).
  View Nominal() const {
    View view;
    view.scene_from_sensor.linear *= kRatio;
    view.scene_from_sensor.offset = -kRatio * Eigen::Vector2d(roi.x0, roi.y0);
    return view;
  }

  View NominalMovedBy(const CornerVector& d, double gain = 1.0, double offset = 0.0) const {
    return {Displace(Nominal().scene_from_sensor, roi, d), gain, offset};
  }

  // A prior of independent corner displacements about `mean`.
  ViewPrior PriorAbout(const View& mean, double sigma_px, ViewModel model = ViewModel::kAffine) const {
    ViewPrior prior;
    prior.mean = mean;
    const int n = ParameterCount(model);
    prior.information = CornerMatrix::Identity(n, n) / (sigma_px * sigma_px);
    return prior;
  }

  Image<float> Frame(const View& view, std::uint64_t stream) const {
    Rng rng({stream, 31});
    Image<float> frame(roi.width(), roi.height());
    for (int v = 0; v < roi.height(); ++v) {
      for (int u = 0; u < roi.width(); ++u) {
        const Eigen::Vector2d cell = view.scene_from_sensor * Eigen::Vector2d(roi.x0 + u, roi.y0 + v) - Eigen::Vector2d(x0, y0);
        TREM_CHECK(CubicSupported(prediction, cell.x(), cell.y()));
        frame.at(u, v) =
            static_cast<float>(view.gain * SampleCubic(prediction, cell.x(), cell.y()) + view.offset + noise_sigma * rng.Normal());
      }
    }
    return frame;
  }
};

inline CornerVector Corners(double a, double b, double c, double d, double e, double f) {
  CornerVector corners(6);
  corners << a, b, c, d, e, f;
  return corners;
}

// The nominal view turned about the ROI's centre by +-`angle_rad` and moved by `distance_px` in a random direction.
inline View TurnedAndMoved(const SyntheticScene& scene, double distance_px, double angle_rad, Rng* rng) {
  const double turn = rng->Uniform() < 0.5 ? angle_rad : -angle_rad;
  const double direction = 2.0 * std::numbers::pi * rng->Uniform();
  const Eigen::Vector2d centre(0.5 * (scene.roi.x0 + scene.roi.x1 - 1), 0.5 * (scene.roi.y0 + scene.roi.y1 - 1));
  Affine moved;
  moved.linear << std::cos(turn), -std::sin(turn), std::sin(turn), std::cos(turn);
  moved.offset = centre - moved.linear * centre + distance_px * Eigen::Vector2d(std::cos(direction), std::sin(direction));
  View view = scene.Nominal();
  view.scene_from_sensor = view.scene_from_sensor * PlanarMap(moved);
  return view;
}

inline CornerVector RandomCorners(Rng* rng, double sigma_px) {
  CornerVector corners(6);
  for (int k = 0; k < 6; ++k) corners(k) = sigma_px * rng->Normal();
  return corners;
}

}  // namespace trem::testing
