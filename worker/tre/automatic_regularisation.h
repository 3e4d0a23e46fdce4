#pragma once

#include <array>
#include <optional>

#include "worker/registration/target.h"
#include "worker/registration/view.h"
#include "worker/sensor/psf.h"
#include "worker/tre/information_update.h"
#include "worker/tre/scene_buffer.h"
#include "worker/tre/structure_prior.h"

namespace trem {

// What the next steps use.
struct StructureWeight {
  float lambda = 0.0F;  // Of the prior's energy beside 1/2 sum W (B S - Z / W)^2.
  float delta = 4.0F;   // Of Huber's psi, grey levels per cell.
};

// Finds the weight of the structure prior from the data, frame by frame, in two steps.
//
// 1. Scale. With m = mean and r = root mean square of |difference of neighbouring seen cells| of the present scene, s = sqrt(m r), and n
//    the frames that have seen them,
//
//      lambda_0 = c sigma^2 / (s^2 + 2 v s sigma / (1 + n)),   delta = m (1 + 1 / n),
//
//    so that a scene of twice the contrast under twice the noise is twice the scene. The second part of the denominator stands for the
//    differences that the prior itself has taken away, most of all from a single frame.
// 2. Prediction. lambda = f lambda_0, where log f is the state of a recursive prediction-error estimate: after each frame a small probe
//    (a tile of the scene, another place every time) is iterated under half and under twice the weight; the next frame, before it is
//    used, tells which of the two predicts it better. With r its residuals and d = dP / d log f by the two probes,
//      J <- kept J + sum d^2 / sigma^2,   log f <- log f + (sum r d / sigma^2) / J.
//    It accounts for whatever limits prediction: texture, noise, views, a wrong PSF. The weight that predicts best is
//    near the one that shows the finest scene in the band that is handed out (emitted_band.h).
//
// Without learning lambda = 0.0031 sigma^2 (1 + 0.03 n), delta = 4, whatever the scene.
//
// Deterministic. Cost: 2 x 8 iterations on a quarter of the ROI for the first six frames, for every third frame after on a ninth, at most
// 32 sensor pixels a side. Sources: Ljung & Soderstrom, Theory and Practice of Recursive Identification, 1983, 3.6 (recursive prediction
// error); Dawid, JRSS A 147, 1984 (prequential).
class AutomaticRegularisation {
 public:
  AutomaticRegularisation(const SeparablePsf& psf, StructurePriorKind kind, int ratio, bool learn = true, int threads = 1);

  // Holds the probe against a registered frame that the scene has not used yet.
  void Learn(const Observation& observation, const View& view);
  // The weight for steps on `region` (scene plane).
  StructureWeight Weight(const Roi& region, const SceneBuffer& buffer, double noise_sigma) const;
  // Makes the next probe in the middle part of `region`: cells that the next frame will see.
  void MakeProbe(const Roi& region, const SceneBuffer& buffer, double noise_sigma);

  // log f.
  double log_factor() const { return log_factor_; }

 private:
  struct Probe {
    Roi inner;   // Of the scene plane: where both predictions hold.
    Roi extent;  // Of the trials' images.
  };
  // The tile under one weight. Keeps its memory from probe to probe.
  struct Trial {
    explicit Trial(const SeparablePsf& psf) : update(Blur(psf), {}), tile(Roi{}) {}
    // Iterates `inner` from the present scene of `extent`; the prediction is left in tile.prediction.
    void Run(const SceneBuffer& buffer, const Roi& inner, const Roi& extent, const StructurePrior& prior, float lambda);

    InformationUpdate update;
    SceneBuffer tile;
  };

  int radius() const { return trials_[0].update.psf().radius(); }

  StructurePriorKind kind_;
  int ratio_;
  bool learn_;
  int threads_;
  std::array<Trial, 2> trials_;  // Half the weight, twice the weight.
  std::optional<Probe> probe_;
  double log_factor_ = 0.0;
  double information_;
  int probe_count_ = 0;
};

}  // namespace trem
