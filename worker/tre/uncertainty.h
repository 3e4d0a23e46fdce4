#pragma once

#include <cstdint>

#include "mosaic/base/image.h"
#include "worker/registration/target.h"
#include "worker/registration/view.h"
#include "worker/sensor/blur.h"
#include "worker/tre/scene_buffer.h"
#include "worker/tre/structure_prior.h"

namespace trem {

struct UncertaintyOptions {
  // Draws from the posterior. The variance of a cell is averaged over them and over 5 x 5 cells.
  int probes = 6;
  // Steps towards each draw's optimum.
  int iterations = 40;
  std::uint64_t seed = 0;
  int threads = 1;  // So many draws at a time, each with memory of its own. The result does not depend on it.
};

// Standard deviation of the scene's error a cell [internal grey levels], 0 where `buffer.seen` is 0.
//
// Perturb and MAP: with H = B' W B + lambda D' V D, D the differences of neighbours, V = min(1, delta / |D S|) the weights of Huber's psi
// at the scene (a membrane: 1), the posterior covariance is sigma^2 H^-1, and the minimiser x of the same quadratic with the data's
// right-hand side drawn from N(0, sigma^2 W) and the prior's from N(0, sigma^2 lambda V) is a draw from it. The same accelerated SQS
// steps as the scene update's find it. Source: Papandreou & Yuille, NIPS 2010.
//
// The structure prior is not what scenes are drawn from: real ones have edges that it smooths. The draws' standard deviation is therefore
// calibrated against simulated truth and joined by a term for what the prior smooths, in proportion to the scene's slope; errors count
// against truth filtered by [1 2 1] / 4 on the scene's grid. `residual` is ResidualMap::Rms: where the residuals are larger than the noise,
// what is left of the model's error counts as noise. Random numbers are keyed by the seed and the cells' places in the scene plane.
Image<float> SceneSigma(const SceneBuffer& buffer, const Image<float>& residual, const Psf& psf, const StructurePrior& prior, float lambda,
                        double noise_sigma, const UncertaintyOptions& options);

// Accumulates squared residuals where samples fall on the scene plane, frame by frame.
class ResidualMap {
 public:
  explicit ResidualMap(const Roi& extent) : extent_(extent), weight_(extent.width(), extent.height()), squares_(weight_) {}

  void MoveTo(const Roi& extent);
  // Adds the residuals of a frame against buffer.prediction: squares up to Huber's limit, linear beyond.
  void Add(const Observation& observation, const View& view, double huber_sigmas, const SceneBuffer& buffer);
  // Robust root mean square of the residuals a cell [internal grey levels] over a tent of a sensor pixel to each side; 0 without samples.
  Image<float> Rms(int ratio) const;

 private:
  Roi extent_;
  Image<float> weight_;
  Image<float> squares_;
};

}  // namespace trem
