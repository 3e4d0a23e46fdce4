#pragma once

#include <vector>

#include "worker/registration/target.h"
#include "worker/registration/view.h"
#include "worker/sensor/blur.h"
#include "worker/tre/curvature_bound.h"
#include "worker/tre/scene_buffer.h"
#include "worker/tre/structure_prior.h"
#include "worker/tre/update_sweep.h"

namespace trem {

struct InformationOptions {
  StructurePrior prior;
  double forgetting = 1.0;    // Factor on W and Z per frame, (0, 1].
  double huber_sigmas = 3.0;  // Samples further than this from the prediction lose weight.
  double momentum_max = 0.9;
  // False: every stage of an iteration passes over the whole region, as is always done for priors other than HUBER_TV and MEMBRANE.
  // Slower, for comparison.
  bool fused = true;
  int threads = 1;  // The result does not depend on it.
};

// The information-form update: per cell accumulate W (weights) and Z (weighted, residual-corrected samples), and improve the scene by a
// few accelerated steps on
//
//   1/2 sum_c W_c ((B S)_c - Z_c / W_c)^2  +  lambda * sum psi(grad S)
//
// Nesterov's momentum is applied at the end of a step: buffer->scene is where the next one begins, extrapolated, and buffer->previous what
// the last one made. So buffer->prediction, B of the scene, is also what the next step needs first. Memory and time do not grow with the
// number of frames. The step is the separable quadratic surrogate's (diagonal majoriser
// |B|' W |B| 1 + 8 lambda; a PSF that is not negative and sums to 1 makes that B' W + 8 lambda), so it needs no tuning and well and
// badly seen cells converge alike. Source: Erdogan & Fessler, Phys. Med. Biol. 44, 1999 (SQS); Nesterov 1983 (momentum).
class InformationUpdate {
 public:
  InformationUpdate(Blur blur, const InformationOptions& options) : blur_(std::move(blur)), bound_(blur_.psf()), options_(options) {}

  // Splats every pixel of `observation` to its nearest cell of `buffer`. `lambda`-independent. Pixels that are NaN or fall outside the
  // buffer are left out. `region` (scene plane) is where forgetting applies: the cells that this frame sees.
  void AddFrame(const Observation& observation, const View& view, const Roi& region, SceneBuffer* buffer) const;
  // Recomputes buffer->majoriser and buffer->seen on `region` (scene plane).
  void UpdateSeen(const Roi& region, int ratio, SceneBuffer* buffer);
  // As UpdateSeen, but only when a cell of `region` has no count, or `every` frames have been added since, or it is not known how much they
  // may have added to the majoriser. Otherwise the steps take a bound of that for it (SceneBuffer::Count::slack). Whether it counted.
  bool RefreshSeen(const Roi& region, int ratio, int every, SceneBuffer* buffer);
  // Runs `iterations` steps on `region` (scene plane). Needs UpdateSeen after the last AddFrame, and buffer->prediction to be B of the
  // scene on the region and the PSF's radius around it, as which it leaves it: as long as what else changes the scene predicts what it has
  // changed, with the radius around it, that is so everywhere.
  void Iterate(const Roi& region, int iterations, float lambda, SceneBuffer* buffer);
  // As Iterate, momentum begun anew and growing without a bound (FISTA's): for many steps on samples that no longer change. Makes the
  // prediction that it needs by itself; the scene is what the last step made, not extrapolated.
  void Converge(const Roi& region, int iterations, float lambda, SceneBuffer* buffer);
  // The steps that follow gain momentum from the start, as a new object's.
  void Restart() { steps_ = 0; }
  // buffer->prediction = B S on `region`.
  void Predict(const Roi& region, SceneBuffer* buffer);
  // Replaces the structure prior of the steps that follow.
  void set_prior(const StructurePrior& prior) { options_.prior = prior; }
  const Psf& psf() const { return blur_.psf(); }
  // Of the frames that follow; see InformationOptions.
  void set_forgetting(double forgetting) { options_.forgetting = forgetting; }

 private:
  // Memory of one thread.
  struct Scratch {
    Blur blur;
    std::vector<float> tents;
    std::vector<float> near;
  };

  Scratch& ScratchOf(int slot);
  void FitScratch();
  // Keeps the majoriser valid for a PSF whose separable terms leave a little negative mass n: with |B| = B + 2 N, N the negative part,
  // |B| 1 = 1 + 2 n and N' W <= 4 n max W (reflection folds up to four cells on one), so (1 + 2 n) (B' W + 8 n max W) bounds
  // |B|' W |B| 1. Nothing to do when n == 0.
  void AddNegativePart(const Roi& inner, SceneBuffer* buffer) const;
  // The momentum after the next iteration.
  float NextMomentum();
  void IterateFused(const Roi& inner, int iterations, float lambda, SceneBuffer* buffer);
  void IterateInPasses(const Roi& inner, int iterations, float lambda, SceneBuffer* buffer);

  Blur blur_;
  CurvatureBound bound_;
  InformationOptions options_;
  int steps_ = 0;
  std::vector<UpdateSweep> sweeps_;  // One per thread.
  std::vector<Scratch> scratch_;     // One per thread.
  Image<float> next_scene_;          // Where the tiles of a large region are written.
  Image<float> next_previous_;
  Image<float> next_prediction_;
  Image<float> residual_;
  Image<float> gradient_;
};

}  // namespace trem
