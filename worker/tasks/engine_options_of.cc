#include "worker/tasks/engine_options_of.h"

#include <algorithm>
#include <cmath>

#include "worker/tasks/sensor_of.h"

namespace trem {
namespace {

Correction CorrectionOf(v1::Correction asked) {
  if (asked == v1::CORRECTION_ON) return Correction::kOn;
  return asked == v1::CORRECTION_OFF ? Correction::kOff : Correction::kAuto;
}

}  // namespace

EngineOptions EngineOptionsOf(const v1::TaskSpec& spec, const v1::SortieManifest& manifest) {
  const v1::Sortie& sortie = spec.sortie();
  EngineOptions options;
  options.psf = PsfParametersOf(sortie.sensor(), manifest.sensor());
  if (sortie.tre().ratio() > 0) options.ratio = static_cast<int>(sortie.tre().ratio());
  switch (sortie.tre().registration()) {
    case v1::GAUSS_NEWTON: options.registration = RegistrationMethod::kGaussNewton; break;
    case v1::HINTS: options.registration = RegistrationMethod::kHints; break;
    case v1::HINTS_THEN_GAUSS_NEWTON: options.registration = RegistrationMethod::kHintsThenGaussNewton; break;
    case v1::PAIRWISE: options.registration = RegistrationMethod::kPairwise; break;
    default: options.registration = RegistrationMethod::kAuto; break;
  }
  options.view_model = sortie.tre().view_model() == v1::PROJECTIVE ? ViewModel::kProjective : ViewModel::kAffine;
  options.gain_offset = sortie.tre().gain_offset() == v1::MARGINALISED ? GainOffset::kMarginalised : GainOffset::kMaximumLikelihood;
  options.dynamics_sigma_px = sortie.tre().dynamics_sigma_px();
  switch (sortie.tre().update()) {
    case v1::LANDWEBER: options.update = UpdateMethod::kLandweber; break;
    case v1::POINTWISE: options.update = UpdateMethod::kPointwise; break;
    default: options.update = UpdateMethod::kInformation; break;
  }
  if (sortie.tre().landweber_window() > 0) options.landweber_window = static_cast<int>(sortie.tre().landweber_window());
  options.landweber_revisit = sortie.tre().landweber_revisit();
  switch (sortie.tre().structure()) {
    case v1::MEMBRANE: options.structure = StructurePriorKind::kMembrane; break;
    case v1::LAPLACIAN: options.structure = StructurePriorKind::kLaplacian; break;
    case v1::BILATERAL_TV: options.structure = StructurePriorKind::kBilateralTv; break;
    default: options.structure = StructurePriorKind::kHuberTv; break;
  }
  if (sortie.tre().structure_weight() > 0.0) options.structure_weight = sortie.tre().structure_weight();
  options.iterations = static_cast<int>(sortie.tre().iterations());
  options.forgetting = sortie.tre().forgetting();
  options.noise_known = sortie.sensor().noise_sigma() > 0.0;
  // Below half a grey level the quantisation of 8-bit sources dominates.
  options.noise_sigma = options.noise_known ? sortie.sensor().noise_sigma() / manifest.grey_scale() : std::max(manifest.noise_sigma(), 0.5);
  if (options.noise_known && sortie.sensor().shot_noise() > 0.0) {
    options.noise_sigma = std::sqrt(NoiseModelOf(sortie.sensor(), manifest).typical_variance);
  }
  options.detector_bias = CorrectionOf(sortie.sensor().detector_bias());
  options.mover_mask = CorrectionOf(sortie.tre().mover_mask());
  options.seed = spec.seed();
  return options;
}

}  // namespace trem
