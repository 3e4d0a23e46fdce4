#include "worker/tasks/estimate_sensor.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "proto/codec/convert.h"
#include "worker/sortie/frame_reader.h"
#include "worker/sortie/frame_source.h"
#include "worker/tasks/pixel_use.h"
#include "worker/tasks/sensor_of.h"
#include "worker/tre/frame_spectrum.h"
#include "worker/tre/psf_estimate.h"

namespace trem {
namespace {

constexpr std::size_t kFramesMax = 16;
// A few thousand tiles show the spectrum as well as more do.
constexpr int kTilesEnough = 4000;

// Usable frames, spread evenly over the sortie.
std::vector<int> ChooseFrames(const v1::SortieManifest& manifest) {
  std::vector<int> usable;
  for (int i = 0; i < manifest.frames_size(); ++i) {
    if (manifest.frames(i).state() == v1::FRAME_USABLE) usable.push_back(i);
  }
  const std::size_t count = std::min(kFramesMax, usable.size());
  std::vector<int> chosen;
  for (std::size_t k = 0; k < count; ++k) chosen.push_back(usable[(2 * k + 1) * usable.size() / (2 * count)]);
  return chosen;
}

Result<FrameSpectrum> SpectrumOf(const v1::Sortie& sortie, const v1::SortieManifest& manifest,
                                 const std::function<bool(double)>& progress) {
  FrameSpectrum spectrum;
  const std::vector<int> indices = ChooseFrames(manifest);
  if (indices.empty()) return spectrum;
  TREM_ASSIGN_OR_RETURN(const PixelUse pixel_use, PixelUse::Of(sortie.sensor(), manifest));
  TREM_ASSIGN_OR_RETURN(const std::unique_ptr<FrameReader> reader, OpenFrames(manifest));
  for (std::size_t k = 0; k < indices.size() && spectrum.tile_count() < kTilesEnough; ++k) {
    if (progress && !progress(static_cast<double>(k) / static_cast<double>(indices.size()))) return Cancelled("asked to stop");
    TREM_ASSIGN_OR_RETURN(const Image<float> whole, reader->Read(indices[k]));
    FrameInput frame;
    pixel_use.Take(whole, FromProto(manifest.valid_roi()), &frame);
    spectrum.Add(frame.pixels);
  }
  return spectrum;
}

struct Width {
  double sigma_px = 0.0;
  double error_px = 0.0;
};

// The estimate beside what sensors usually are.
Width BesideUsualSensors(const PsfEstimate& estimate) {
  constexpr double kUsualSpread_px = 0.15;
  const double own = 1.0 / (estimate.error_px * estimate.error_px);
  const double usual = 1.0 / (kUsualSpread_px * kUsualSpread_px);
  return {(own * estimate.sigma_px + usual * kPsfSigmaAssumed_px) / (own + usual), 1.0 / std::sqrt(own + usual)};
}

}  // namespace

Status EstimateSensor(const v1::Sortie& sortie, const std::function<bool(double)>& progress, v1::SortieManifest* manifest) {
  const bool gaussian = sortie.sensor().psf_model() == v1::GAUSSIAN || sortie.sensor().psf_model() == v1::PSF_AUTO;
  if (!gaussian || sortie.sensor().psf_sigma_px() > 0.0) return {};
  TREM_ASSIGN_OR_RETURN(const FrameSpectrum spectrum, SpectrumOf(sortie, *manifest, progress));
  const double fill_factor = PsfParametersOf(sortie.sensor(), manifest->sensor()).fill_factor;
  const PsfEstimate estimate = EstimatePsfSigma(spectrum, fill_factor);

  v1::SensorManifest* sensor = manifest->mutable_sensor();
  const bool used = estimate.doubt.empty();
  const Width width = used ? BesideUsualSensors(estimate) : Width{kPsfSigmaAssumed_px, 0.0};
  sensor->set_psf_sigma_px(width.sigma_px);
  sensor->set_psf_sigma_error_px(width.error_px);
  std::string text =
      used ? fmt::format("the point spread function was estimated: psf_sigma_px {:.2f} +- {:.2f}; the frames alone say {:.2f}",
                         width.sigma_px, width.error_px, estimate.sigma_px)
           : fmt::format("psf_sigma_px {:.2f} is assumed: it could not be estimated ({})", kPsfSigmaAssumed_px, estimate.doubt);
  if (used && sortie.sensor().noise_sigma() == 0.0 && sortie.sensor().shot_noise() == 0.0 && estimate.noise_sigma > 0.0 &&
      estimate.noise_sigma < manifest->noise_sigma()) {
    manifest->set_noise_sigma(estimate.noise_sigma);
    text += fmt::format(", noise {:.2f} grey levels", estimate.noise_sigma * manifest->grey_scale());
  }
  *manifest->add_notes() = MakeNote(v1::INFO, "psf_estimate", sortie.source().path(), text);
  return {};
}

}  // namespace trem
