#pragma once

#include <cstdint>

#include "worker/registration/registration.h"
#include "worker/sensor/psf.h"
#include "worker/tre/structure_prior.h"
#include "worker/tre/update_scheme.h"

namespace trem {

// Whether something that not every sortie needs is estimated and removed.
enum class Correction {
  kAuto,  // When the frames show it.
  kOn,
  kOff,
};

// How TRE runs on a window. Every 0 or default is a good choice for an unknown sortie.
struct EngineOptions {
  PsfParameters psf;
  int ratio = 3;
  RegistrationMethod registration = RegistrationMethod::kAuto;
  ViewModel view_model = ViewModel::kAffine;
  GainOffset gain_offset = GainOffset::kMaximumLikelihood;
  // Standard deviation of the change of a ROI corner's velocity from frame to frame, sensor px. 0: automatic, the whole images' motion
  // where it was measured.
  double dynamics_sigma_px = 0.0;
  UpdateMethod update = UpdateMethod::kInformation;
  int landweber_window = 8;         // kLandweber: frames of the batch window, 1 .. 64.
  bool landweber_revisit = false;   // kLandweber: earlier frames of the window are registered again to the improved scene.
  StructurePriorKind structure = StructurePriorKind::kHuberTv;
  double structure_weight = 1.0;  // Factor on the automatic regularisation. Raise it for smoother, lower for crisper and noisier scenes.
  // False: the weight follows noise and frames alone. For holding sensor models against each other: a weight that is learnt from
  // prediction makes up for a wrong one.
  bool learn_weight = true;
  int iterations = 0;             // Scene updates a frame. 0: 4.
  double forgetting = 0.0;        // Per frame, (0, 1]. 0: automatic.
  double noise_sigma = 2.0;       // Internal grey levels; first guess unless `noise_known`.
  bool noise_known = false;       // True: noise_sigma is used as given; false: refined from the residuals.
  int threads = 1;                // For one ROI. Workers are one process a core and keep 1; the result does not depend on it.
  Correction detector_bias = Correction::kAuto;  // Fixed pattern and bad pixels of the detector.
  Correction mover_mask = Correction::kAuto;     // What moves in the scene; kAuto: not masked.
  // Whether snapshots carry residuals and a standard deviation per cell. Costs a pass over each frame, and at a snapshot about as much as
  // 60 frames.
  bool uncertainty = false;
  std::uint64_t seed = 0;         // Names the random streams of HINTS, of kPointwise and of the draws behind standard deviations.
};

}  // namespace trem
