#include "worker/tasks/engine_options_of.h"

#include <algorithm>
#include <numbers>

namespace trem {

namespace {

PsfParameters PsfParametersOf(const v1::Sensor& sensor) {
  PsfParameters psf;
  if (sensor.fill_factor() > 0.0) psf.fill_factor = sensor.fill_factor();
  if (sensor.psf_model() == v1::OPTICS) {
    psf.model = PsfModel::kOptics;
    psf.q = sensor.wavelength_um() * sensor.f_number() / sensor.pixel_pitch_um();
    psf.sigma_px = sensor.psf_sigma_px();
  } else if (sensor.psf_sigma_px() > 0.0) {
    psf.sigma_px = sensor.psf_sigma_px();
  }
  psf.smear_px = sensor.smear_px();
  psf.smear_direction_rad = sensor.smear_direction_deg() * std::numbers::pi / 180.0;
  return psf;
}

}  // namespace

EngineOptions EngineOptionsOf(const v1::TaskSpec& spec, const v1::SortieManifest& manifest) {
  const v1::Sortie& sortie = spec.sortie();
  EngineOptions options;
  options.psf = PsfParametersOf(sortie.sensor());
  if (sortie.tre().ratio() > 0) options.ratio = static_cast<int>(sortie.tre().ratio());
  switch (sortie.tre().registration()) {
    case v1::GAUSS_NEWTON: options.registration = RegistrationMethod::kGaussNewton; break;
    case v1::HINTS: options.registration = RegistrationMethod::kHints; break;
    case v1::HINTS_THEN_GAUSS_NEWTON: options.registration = RegistrationMethod::kHintsThenGaussNewton; break;
    case v1::PAIRWISE: options.registration = RegistrationMethod::kPairwise; break;
    default: options.registration = RegistrationMethod::kAuto; break;
  }
  options.view_model = sortie.tre().view_model() == v1::PROJECTIVE ? ViewModel::kProjective : ViewModel::kAffine;
  options.structure = sortie.tre().structure() == v1::MEMBRANE ? StructurePriorKind::kMembrane : StructurePriorKind::kHuberTv;
  if (sortie.tre().structure_weight() > 0.0) options.structure_weight = sortie.tre().structure_weight();
  options.iterations = static_cast<int>(sortie.tre().iterations());
  options.forgetting = sortie.tre().forgetting();
  options.noise_known = sortie.sensor().noise_sigma() > 0.0;
  // Below half a grey level the quantisation of 8-bit sources dominates.
  options.noise_sigma = options.noise_known ? sortie.sensor().noise_sigma() / manifest.grey_scale() : std::max(manifest.noise_sigma(), 0.5);
  options.seed = spec.seed();
  return options;
}

}  // namespace trem
