#include "worker/registration/registration.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "worker/registration/hints_registration.h"
#include "worker/registration/pairwise.h"

namespace trem {
namespace {

constexpr double kUsablePartMin = 0.05;
constexpr double kCorrelationMin = 0.6;
// Residuals this many times the noise are explained by noise and a little model error.
constexpr double kNoiseExplains = 1.6;

// Why the frame itself cannot be registered, whatever the scene (empty: it can).
std::string DoubtOfFrame(const Observation& observation) {
  float lowest = std::numeric_limits<float>::max();
  float highest = std::numeric_limits<float>::lowest();
  long long usable = 0;
  const double needed = kUsablePartMin * static_cast<double>(observation.roi.area());
  for (int v = 0; v < observation.roi.height(); ++v) {
    const float* pixels = observation.roi_pixels->row(v);
    for (int u = 0; u < observation.roi.width(); ++u) {
      if (!std::isfinite(pixels[u]) || !(observation.weight(u, v) > 0.0F)) continue;
      lowest = std::min(lowest, pixels[u]);
      highest = std::max(highest, pixels[u]);
      ++usable;
    }
    if (static_cast<double>(usable) >= needed && highest > lowest) return {};
  }
  if (static_cast<double>(usable) < needed) {
    char text[160];
    std::snprintf(text, sizeof text, "has %lld usable pixels of the ROI's %lld; at least %.0f %% needed", usable,
                  static_cast<long long>(observation.roi.area()), 100.0 * kUsablePartMin);
    return text;
  }
  if (!(highest > lowest)) return "shows nothing: all its usable pixels have one grey level";
  return {};
}

// A view that no camera takes: not finite, turned over, or collapsed to a line or a point (or blown up) somewhere in the ROI.
bool Singular(const PlanarMap& scene_from_sensor, const Roi& roi, int ratio) {
  constexpr double kAreaFactorMax = 16.0;
  for (const int x : {roi.x0, roi.x1 - 1}) {
    for (const int y : {roi.y0, roi.y1 - 1}) {
      const Eigen::Vector2d u(x, y);
      if (!(scene_from_sensor.Depth(u) > 0.0)) return true;
      const double area = std::abs(scene_from_sensor.LinearisedAt(u).linear.determinant()) / (static_cast<double>(ratio) * ratio);
      if (!(area > 1.0 / kAreaFactorMax && area < kAreaFactorMax)) return true;
    }
  }
  return false;
}

std::string Doubt(const Registration& registration, const Observation& observation, const Reference& reference, double motion_px_max) {
  char text[160];
  if (Singular(registration.view.scene_from_sensor, observation.roi, reference.ratio)) {
    return "ended in a singular view: its ROI would collapse or blow up more than 16 times in the scene";
  }
  if (registration.overlap < kRegistrationOverlapMin) {
    std::snprintf(text, sizeof text, "overlaps the scene by %.0f %% only; at least %.0f %% needed", 100.0 * registration.overlap,
                  100.0 * kRegistrationOverlapMin);
    return text;
  }
  if (registration.correlation < kCorrelationMin && registration.residual_rms > kNoiseExplains * observation.noise_sigma) {
    std::snprintf(text, sizeof text,
                  "does not match the scene: correlation %.2f (at least %.2f needed), residual %.1f grey levels at noise %.1f",
                  registration.correlation, kCorrelationMin, registration.residual_rms, observation.noise_sigma);
    return text;
  }
  if (registration.motion_from_prior_px > motion_px_max) {
    std::snprintf(text, sizeof text, "would have moved %.1f px from where the whole images put it; at most %.1f px believed",
                  registration.motion_from_prior_px, motion_px_max);
    return text;
  }
  if (!(registration.view.gain > 0.1 && registration.view.gain < 10.0)) {
    std::snprintf(text, sizeof text, "would need a gain of %.2f against the scene; expected 0.1 .. 10", registration.view.gain);
    return text;
  }
  return {};
}

// Far from where it was expected and with more than noise left: ground that looks alike may have caught it, which correlates well enough
// to be believed.
bool MayBeAnotherPlace(const Registration& registration, const Observation& observation) {
  constexpr double kFarPx = 2.0;
  return registration.motion_from_prior_px > kFarPx && registration.residual_rms > kNoiseExplains * observation.noise_sigma;
}

JudgedRegistration Judge(Registration registration, const Observation& observation, const Reference& reference,
                         const RegistrationRequest& request) {
  JudgedRegistration judged{std::move(registration), {}};
  judged.doubt = Doubt(judged.registration, observation, reference, request.motion_px_max);
  return judged;
}

// Gauss-Newton over `levels` reduced levels, started at `start` but believing the same prior.
JudgedRegistration TryFrom(const View& start, int levels, const Observation& observation, const Reference& reference,
                           const RegistrationRequest& request) {
  GaussNewtonOptions options;
  options.pyramid_levels = levels;
  options.gain_offset = request.gain_offset;
  options.threads = request.threads;
  return Judge(RegisterGaussNewton(observation, reference, request.prior, start, options), observation, reference, request);
}

JudgedRegistration GaussNewtonWithPyramids(const Observation& observation, const Reference& reference, const RegistrationRequest& request) {
  JudgedRegistration best = TryFrom(request.prior.mean, 0, observation, reference, request);
  if (best.doubt.empty()) return best;
  std::vector<View> starts{request.prior.mean};
  starts.insert(starts.end(), request.candidates.begin(), request.candidates.end());
  for (const View& start : starts) {
    JudgedRegistration next = TryFrom(start, 3, observation, reference, request);
    if (next.doubt.empty()) return next;
    if (next.registration.correlation > best.registration.correlation) best = std::move(next);
  }
  return best;
}

}  // namespace

JudgedRegistration Register(const Observation& observation, const Reference& reference, const RegistrationRequest& request) {
  const std::string doubt = DoubtOfFrame(observation);
  if (!doubt.empty()) {
    JudgedRegistration judged{{}, doubt};
    judged.registration.view = request.prior.mean;
    judged.registration.corner_covariance = CornerMatrix::Zero(request.prior.information.rows(), request.prior.information.rows());
    return judged;
  }
  switch (request.method) {
    case RegistrationMethod::kHints: {
      HintsSettings settings;
      settings.gain_offset = request.gain_offset;
      return Judge(RegisterHints(observation, reference, request.prior, HintsUse::kFull, request.stream, settings), observation, reference,
                   request);
    }
    case RegistrationMethod::kPairwise:
      return Judge(RegisterPairwise(observation, reference, request.prior, FullChart(request.prior, observation.roi), {}), observation,
                   reference, request);
    case RegistrationMethod::kHintsThenGaussNewton: {
      const Registration captured = RegisterHints(observation, reference, request.prior, HintsUse::kCapture, request.stream);
      return TryFrom(captured.view, 0, observation, reference, request);
    }
    case RegistrationMethod::kGaussNewton:
      return GaussNewtonWithPyramids(observation, reference, request);
    case RegistrationMethod::kAuto:
      break;
  }
  JudgedRegistration judged = GaussNewtonWithPyramids(observation, reference, request);
  const bool believed = judged.doubt.empty();
  if (believed && !MayBeAnotherPlace(judged.registration, observation)) return judged;
  const Registration captured = RegisterHints(observation, reference, request.prior, HintsUse::kCapture, request.stream);
  JudgedRegistration second = TryFrom(captured.view, 2, observation, reference, request);
  if (!second.doubt.empty()) return judged;
  return believed && judged.registration.residual_rms <= second.registration.residual_rms ? judged : second;
}

}  // namespace trem
