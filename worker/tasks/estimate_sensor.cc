#include "worker/tasks/estimate_sensor.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "proto/codec/convert.h"
#include "worker/sortie/frame_reader.h"
#include "worker/sortie/frame_source.h"
#include "worker/tasks/engine_options_of.h"
#include "worker/tasks/pixel_use.h"
#include "worker/tre/psf_estimate.h"

namespace trem {
namespace {

constexpr int kFrames = 16;
constexpr int kFramesMin = 12;
// Side of a trial's ROI; the larger one for fast motion, so that a piece of ground is seen about ten times.
constexpr int kSide_px = 61;
constexpr int kSideFast_px = 101;
constexpr double kFast_px = 4.0;
// A second ROI is tried when the job has this many times its pixels.
constexpr double kJobPerTrial = 80.0;
// Gradients beyond this many noise sigmas count no more: one bright edge is not texture.
constexpr double kGradientSigmasMax = 12.0;
// Mean squared gradient of a trial's ROI, in units of what noise alone shows.
constexpr double kTextureMin = 1.5;
constexpr double kMotionCorrelationMin = 0.3;

// The run of successive usable frames in the middle of the longest span; empty when there is none of kFramesMin.
std::vector<int> ChooseFrames(const v1::SortieManifest& manifest) {
  std::vector<int> longest;
  for (const v1::FrameSpan& span : manifest.spans()) {
    std::vector<int> usable;
    for (int i = static_cast<int>(span.begin()); i < static_cast<int>(span.end()); ++i) {
      if (manifest.frames(i).state() == v1::FRAME_USABLE) usable.push_back(i);
    }
    if (usable.size() > longest.size()) longest = std::move(usable);
  }
  if (longest.size() < kFramesMin) return {};
  const std::size_t count = std::min<std::size_t>(kFrames, longest.size());
  const auto first = longest.begin() + static_cast<std::ptrdiff_t>((longest.size() - count) / 2);
  return {first, first + static_cast<std::ptrdiff_t>(count)};
}

double MedianMotion(const v1::SortieManifest& manifest, const std::vector<int>& frames) {
  std::vector<double> motions_px;
  const Eigen::Vector2d centre(0.5 * manifest.width_px(), 0.5 * manifest.height_px());
  for (const int i : frames) {
    const Result<Affine> motion = AffineFromProto(manifest.frames(i).previous_from_current(), "previous_from_current");
    if (manifest.frames(i).motion_correlation() > 0.0 && motion.ok()) motions_px.push_back(((*motion) * centre - centre).norm());
  }
  if (motions_px.empty()) return 0.0;
  std::nth_element(motions_px.begin(), motions_px.begin() + static_cast<std::ptrdiff_t>(motions_px.size() / 2), motions_px.end());
  return motions_px[motions_px.size() / 2];
}

// Mean squared horizontal and vertical difference of a frame's ROI, clipped, over that of noise; 0 when pixels of it are not used.
double Texture(const FrameInput& frame, double noise_sigma) {
  const double limit = std::pow(kGradientSigmasMax * noise_sigma, 2);
  const Image<float>& pixels = frame.pixels;
  double sum = 0.0;
  for (int y = 1; y < pixels.height(); ++y) {
    for (int x = 1; x < pixels.width(); ++x) {
      sum += std::min(std::pow(pixels.at(x, y) - pixels.at(x - 1, y), 2), limit) + std::min(std::pow(pixels.at(x, y) - pixels.at(x, y - 1), 2), limit);
    }
  }
  if (!std::isfinite(sum)) return 0.0;
  if (!frame.weights.empty() && std::any_of(frame.weights.pixels().begin(), frame.weights.pixels().end(), [](float w) { return w < 0.1F; })) return 0.0;
  return sum / (4.0 * noise_sigma * noise_sigma * (pixels.width() - 1) * (pixels.height() - 1));
}

// Up to `count_max` ROIs of the valid part that do not overlap, most textured first.
std::vector<Roi> ChooseRois(const Image<float>& whole, const PixelUse& pixel_use, const Roi& valid, int side, double noise_sigma, std::size_t count_max) {
  struct Place {
    Roi roi;
    double texture = 0.0;
  };
  std::vector<Place> places;
  const int margin = side / 8;
  for (int y = valid.y0 + margin; y + side <= valid.y1 - margin; y += side / 2) {
    for (int x = valid.x0 + margin; x + side <= valid.x1 - margin; x += side / 2) {
      FrameInput frame;
      const Roi roi{x, y, x + side, y + side};
      pixel_use.Take(whole, roi, &frame);
      const double texture = Texture(frame, noise_sigma);
      if (texture >= kTextureMin) places.push_back({roi, texture});
    }
  }
  std::stable_sort(places.begin(), places.end(), [](const Place& a, const Place& b) { return a.texture > b.texture; });
  std::vector<Roi> chosen;
  for (const Place& place : places) {
    if (chosen.size() == count_max) break;
    if (std::all_of(chosen.begin(), chosen.end(), [&](const Roi& roi) { return Intersect(roi, place.roi).empty(); })) chosen.push_back(place.roi);
  }
  return chosen;
}

Result<std::vector<PsfTrial>> MakeTrials(const v1::Sortie& sortie, const v1::SortieManifest& manifest, double noise_sigma) {
  const std::vector<int> indices = ChooseFrames(manifest);
  if (indices.empty()) return std::vector<PsfTrial>();
  TREM_ASSIGN_OR_RETURN(const PixelUse pixel_use, PixelUse::Of(sortie.sensor(), manifest));
  TREM_ASSIGN_OR_RETURN(const std::unique_ptr<FrameReader> reader, OpenFrames(manifest));
  const int side = MedianMotion(manifest, indices) > kFast_px ? kSideFast_px : kSide_px;
  const Roi valid = FromProto(manifest.valid_roi());
  const double job_pixels = static_cast<double>(manifest.frames_size()) * static_cast<double>(valid.area());
  const double trial_pixels = static_cast<double>(indices.size()) * side * side;
  std::vector<PsfTrial> trials;
  for (const int index : indices) {
    TREM_ASSIGN_OR_RETURN(const Image<float> whole, reader->Read(index));
    if (index == indices.front()) {
      for (const Roi& roi : ChooseRois(whole, pixel_use, valid, side, noise_sigma, job_pixels > 2.0 * kJobPerTrial * trial_pixels ? 2 : 1)) {
        trials.push_back({roi, {}});
      }
    }
    const v1::ManifestFrame& record = manifest.frames(index);
    for (PsfTrial& trial : trials) {
      FrameInput frame;
      frame.frame_index = index;
      pixel_use.Take(whole, trial.roi, &frame);
      if (record.previous_from_current_size() > 0 && record.motion_correlation() >= kMotionCorrelationMin) {
        TREM_ASSIGN_OR_RETURN(frame.previous_from_current, AffineFromProto(record.previous_from_current(), "previous_from_current"));
      }
      trial.frames.push_back(std::move(frame));
    }
  }
  return trials;
}

struct Width {
  double sigma_px = 0.0;
  double error_px = 0.0;
};

// What is believed after the estimate: sensors' widths are about kPsfSigmaAssumed_px, and the estimate errs by more than its own error
// says. Over ground that is seen in a few frames only, a scene that is too smooth under a PSF that is too narrow predicts the next frame
// as well: simulated flights at 4 px a frame gave 0.37 and 0.51 for 0.60.
Width BesideUsualSensors(const PsfEstimate& estimate) {
  constexpr double kUsualSpread_px = 0.06;
  constexpr double kFlightError_px = 0.15;
  const double own = 1.0 / (std::pow(std::max(estimate.error_px, kFlightError_px), 2));
  const double usual = 1.0 / (kUsualSpread_px * kUsualSpread_px);
  return {(own * estimate.sigma_px + usual * kPsfSigmaAssumed_px) / (own + usual), 1.0 / std::sqrt(own + usual)};
}

}  // namespace

Status EstimateSensor(const v1::Sortie& sortie, const std::function<bool(double)>& progress, v1::SortieManifest* manifest) {
  const bool gaussian = sortie.sensor().psf_model() == v1::GAUSSIAN || sortie.sensor().psf_model() == v1::PSF_AUTO;
  if (!gaussian || sortie.sensor().psf_sigma_px() > 0.0) return {};
  v1::TaskSpec spec;
  *spec.mutable_sortie() = sortie;
  spec.set_seed(sortie.seed());
  const EngineOptions options = EngineOptionsOf(spec, *manifest);
  TREM_ASSIGN_OR_RETURN(const std::vector<PsfTrial> trials, MakeTrials(sortie, *manifest, options.noise_sigma));
  TREM_ASSIGN_OR_RETURN(const PsfEstimate estimate, EstimatePsfSigma(trials, options, progress));

  v1::SensorManifest* sensor = manifest->mutable_sensor();
  const bool used = estimate.doubt.empty();
  const Width width = used ? BesideUsualSensors(estimate) : Width{kPsfSigmaAssumed_px, 0.0};
  sensor->set_psf_sigma_px(width.sigma_px);
  sensor->set_psf_sigma_error_px(width.error_px);
  std::string text = used ? fmt::format("the point spread function was estimated: psf_sigma_px {:.2f} +- {:.2f}; the frames alone say {:.2f}",
                                        width.sigma_px, width.error_px, estimate.sigma_px)
                          : fmt::format("psf_sigma_px {:.2f} is assumed: it could not be estimated ({})", kPsfSigmaAssumed_px, estimate.doubt);
  if (used && sortie.sensor().noise_sigma() == 0.0 && sortie.sensor().shot_noise() == 0.0 && estimate.noise_sigma < manifest->noise_sigma()) {
    manifest->set_noise_sigma(estimate.noise_sigma);
    text += fmt::format(", noise {:.2f} grey levels", estimate.noise_sigma * manifest->grey_scale());
  }
  *manifest->add_notes() = MakeNote(v1::INFO, "psf_estimate", sortie.source().path(), text);
  return {};
}

}  // namespace trem
