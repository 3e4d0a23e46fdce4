#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "mosaic/base/image.h"
#include "worker/simulate/flight.h"
#include "worker/simulate/options.h"
#include "worker/simulate/surface.h"
#include "worker/simulate/truth.h"

namespace trem {

// A thing that moves over the ground: an ellipse of one grey level, going straight and back between two places.
struct Mover {
  Eigen::Vector2d start_m = Eigen::Vector2d::Zero();       // Map metres.
  Eigen::Vector2d velocity_m_s = Eigen::Vector2d::Zero();  // Map metres per second; its direction is the long axis.
  double turn_s = 0.0;                                     // Time from one end to the other.
  double half_length_m = 0.0;
  double half_width_m = 0.0;
  double grey = 0.0;

  Eigen::Vector2d At(double time_s) const;
};

// Movers inside the box that the flight sees; sizes and speeds are a few sensor pixels.
std::vector<Mover> MakeMovers(const SimulationOptions& options, const Flight& flight);

// Turns exposures into frames. The radiance of sensor pixel u is
//
//   L(u) = integral k(v) truth(ground_from_sensor(u + v)) dv,   k = Gaussian(psf_sigma_px) * box(fill_factor)
//
// by a product rule on kSubsamples points a pixel and axis over +-(4 sigma + half a box): every point goes through the exact pinhole
// projection of its pixel and is taken from the cubic spline through the truth. The weights fall so smoothly that the rule's error is
// below 1e-6 for sigma >= 0.25 px. This shares nothing with worker/sensor, on purpose: what reconstructs must not be graded by its own
// model.
class Renderer {
 public:
  static constexpr int kSubsamples = 6;

  // `truth` is lent and must outlive the renderer.
  Renderer(const SimulationOptions& options, const Truth& truth, const Flight& flight, std::vector<Mover> movers);

  // Radiance of every sensor pixel before gain, offset and noise, in the truth's grey levels.
  Image<double> Radiance(const Exposure& exposure) const;
  // The digital frame: gain, offset, fixed pattern, noise, dead pixels, rounding. Values up to 255 or 65535. Depends on options, truth
  // and the exposure's index only.
  Image<std::uint16_t> Frame(const Exposure& exposure) const;

 private:
  // What the lens leaves of the light at a pixel (row-major index).
  double LensFactor(std::size_t pixel) const;

  Image<float> Supersampled(const Exposure& exposure) const;
  void DrawMovers(const Exposure& exposure, Image<float>* fine) const;
  Eigen::Vector2d PixelFromFine(int x, int y) const;

  SimulationOptions options_;
  const Truth& truth_;
  SplineSurface surface_;
  double focal_px_ = 0.0;
  std::vector<Mover> movers_;
  int reach_ = 0;                // Subsamples on each side of a pixel's centre.
  std::vector<double> weights_;  // 2 reach_ + 1, sum 1.
  Image<float> fixed_pattern_;   // Grey levels; empty without.
  Image<float> stuck_;           // Grey level of dead pixels, NaN elsewhere; empty without.
};

}  // namespace trem
