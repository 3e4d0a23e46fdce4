#include "worker/tre/target_engine.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <numbers>
#include <vector>

#include "worker/tre/segment.h"
#include "worker/tre/target_motion.h"
#include "worker/tre/target_search.h"

namespace trem {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
// Part of the ROI that must lie in the sensor for the target to be looked for at its predicted place.
constexpr double kInsideMin = 0.35;
// Standard deviation of a target's own velocity before it has moved [px a frame], and of how its picture changes from frame to frame [px
// at a ROI corner].
constexpr double kFirstVelocitySigmaPx = 4.0;
constexpr double kReturnVelocitySigmaPx = 1.5;
constexpr double kShapeSigmaPx = 0.5;
// Accepted registrations that tell what is usual for this target, and how few do not.
constexpr std::size_t kUsualWindow = 15;
constexpr std::size_t kUsualMin = 3;
// Of a search of the whole frame: least correlation of a place that is tried, and how far beyond the prediction it may be.
constexpr double kSightingMin = 0.6;
constexpr int kSightings = 5;
constexpr double kGateSigmas = 4.0;
constexpr double kGateMinPx = 10.0;

// What a registration must reach to be believed, relative to what is usual for the target.
struct Strictness {
  double correlation_min;
  double correlation_drop_max;
  double residual_factor_max;
  double hidden_part_max;
  // Whether residuals that the noise explains make up for a poor correlation. They would do so for flat ground, too.
  bool noise_excuses;
};
constexpr Strictness kTracking{0.6, 0.25, 2.2, 0.30, true};
// Of a target that was lost, wherever it is looked for.
constexpr Strictness kFinding{0.75, 0.12, 1.6, 0.15, false};

Roi Shifted(const Roi& roi, int dx, int dy) { return {roi.x0 + dx, roi.y0 + dy, roi.x1 + dx, roi.y1 + dy}; }

Eigen::Vector2d CentreOf(const Roi& roi) { return {0.5 * (roi.x0 + roi.x1 - 1), 0.5 * (roi.y0 + roi.y1 - 1)}; }

// Pixels outside the frame are not measured.
Image<float> Crop(const Image<float>& frame, const Roi& roi) {
  Image<float> crop(roi.width(), roi.height(), kNan);
  const Roi inside = Intersect(roi, {0, 0, frame.width(), frame.height()});
  for (int y = inside.y0; y < inside.y1; ++y) {
    std::copy(frame.row(y) + inside.x0, frame.row(y) + std::max(inside.x0, inside.x1), crop.row(y - roi.y0) + (inside.x0 - roi.x0));
  }
  return crop;
}

double Median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Gaussian over corner displacements: the target's place, common to the corners, and its shape.
CornerMatrix PriorInformation(ViewModel model, double place_sigma_px, double shape_sigma_px) {
  const int parameters = ParameterCount(model);
  CornerMatrix covariance = CornerMatrix::Identity(parameters, parameters) * shape_sigma_px * shape_sigma_px;
  for (int a = 0; a < parameters / 2; ++a) {
    for (int b = 0; b < parameters / 2; ++b) {
      covariance(2 * a, 2 * b) += place_sigma_px * place_sigma_px;
      covariance(2 * a + 1, 2 * b + 1) += place_sigma_px * place_sigma_px;
    }
  }
  return covariance.inverse();
}

bool TooDeformed(const PlanarMap& scene_from_sensor, const Roi& roi, int ratio) {
  const Eigen::Matrix2d relative = scene_from_sensor.LinearisedAt(CentreOf(roi)).linear / ratio;
  const Eigen::JacobiSVD<Eigen::Matrix2d> svd(relative);
  const double turned = std::abs(std::atan2(relative(1, 0) - relative(0, 1), relative(0, 0) + relative(1, 1)));
  return turned > std::numbers::pi / 3.0 || svd.singularValues()(0) > 1.5 || svd.singularValues()(1) < 1.0 / 1.5;
}

// Says why a ROI cannot be registered to: its weakest direction of gradient energy, less the noise's, does not stand out from what noise
// makes of it. Source: Shi & Tomasi, CVPR 1994 (smaller eigenvalue of the structure tensor).
Status CheckTexture(const Image<float>& crop, const Image<float>& weights, const Roi& roi, double noise_sigma) {
  Eigen::Matrix2d tensor = Eigen::Matrix2d::Zero();
  double count = 0.0;
  for (int y = 1; y + 1 < crop.height(); ++y) {
    for (int x = 1; x + 1 < crop.width(); ++x) {
      const Eigen::Vector2d g(0.5 * (crop.at(x + 1, y) - crop.at(x - 1, y)), 0.5 * (crop.at(x, y + 1) - crop.at(x, y - 1)));
      if (!g.allFinite()) continue;
      tensor += weights.at(x, y) * g * g.transpose();
      count += weights.at(x, y);
    }
  }
  const double noise = 0.5 * noise_sigma * noise_sigma;  // Variance of a central difference.
  const Eigen::JacobiSVD<Eigen::Matrix2d> svd(tensor);
  const double weakest = svd.singularValues()(1) - count * noise;
  if (weakest > 5.0 * noise * std::sqrt(2.0 * count)) return {};
  return InvalidInput("ROI " + ToString(roi) +
                      " has no texture to register to in at least one direction: what varies there is no more than the noise of " +
                      fmt::format("{:.1f}", noise_sigma) + " grey levels; choose a ROI with edges in more than one direction");
}

std::optional<Affine> InverseOf(const std::optional<Affine>& map) {
  if (!map || std::abs(map->linear.determinant()) < 1e-3) return std::nullopt;
  return map->Inverse();
}

// A detector's pattern stays with the sensor's pixels and what moves is masked beside the ground that it covers: neither can be told apart
// in a ROI that goes with a target.
EngineOptions OptionsFor(EngineOptions options) {
  options.detector_bias = Correction::kOff;
  options.mover_mask = Correction::kOff;
  return options;
}

class TargetRun {
 public:
  TargetRun(const TargetRequest& request, const TargetFrames& frames, const EngineOptions& options, const SeparablePsf& psf,
            const SnapshotSink& sink)
      : request_(request),
        frames_(frames),
        options_(OptionsFor(options)),
        sink_(sink),
        weights_(TargetWeights(request.roi_in_sensor.width(), request.roi_in_sensor.height())),
        centre_in_scene_(options.ratio *
                         (CentreOf(request.roi_in_sensor) - Eigen::Vector2d(request.roi_in_sensor.x0, request.roi_in_sensor.y0))),
        noise_sigma_(options.noise_sigma),
        segment_(request.roi_in_sensor, psf, options_, 0, Segment::Extent::kFixed) {
    for (int k = request.frame_begin; k < request.frame_end; ++k) result_.frames.push_back({k, FrameReport::Outcome::kSkipped, {}});
  }

  Result<EngineResult> Run(const std::function<bool(double)>& progress) {
    TREM_ASSIGN_OR_RETURN(const TargetFrame reference, frames_(request_.reference));
    TREM_RETURN_IF_ERROR(Begin(reference));
    const Eigen::Vector2d picked = CentreOf(request_.roi_in_sensor);
    Restart(TargetMotion(picked, Eigen::Vector2d::Zero(), kFirstVelocitySigmaPx));
    for (int k = request_.reference + 1; k < request_.frame_end; ++k) {
      TREM_RETURN_IF_ERROR(Tell(progress));
      TREM_ASSIGN_OR_RETURN(const TargetFrame frame, frames_(k));
      if (Usable(k, frame)) TREM_RETURN_IF_ERROR(Follow(k, frame, InverseOf(frame.previous_from_current)));
    }
    Restart(TargetMotion(picked, -first_velocity_.value_or(Eigen::Vector2d::Zero()),
                         first_velocity_ ? kReturnVelocitySigmaPx : kFirstVelocitySigmaPx));
    std::optional<Affine> to_previous = reference.previous_from_current;
    for (int k = request_.reference - 1; k >= request_.frame_begin; --k) {
      TREM_RETURN_IF_ERROR(Tell(progress));
      TREM_ASSIGN_OR_RETURN(const TargetFrame frame, frames_(k));
      if (!Usable(k, frame)) continue;
      TREM_RETURN_IF_ERROR(Follow(k, frame, to_previous));
      to_previous = frame.previous_from_current;
    }
    TREM_RETURN_IF_ERROR(segment_.End(noise_sigma_, [this](const SceneSnapshot& s) { return sink_(0, s); }));
    std::vector<ChainEntry>& chain = result_.segments[0].chain;
    std::sort(chain.begin(), chain.end(), [](const ChainEntry& a, const ChainEntry& b) { return a.frame_index < b.frame_index; });
    result_.noise_sigma = noise_sigma_;
    return std::move(result_);
  }

 private:
  using Outcome = FrameReport::Outcome;

  // What one attempt to register a frame came to.
  struct Attempt {
    FrameInput input;
    JudgedRegistration judged;
    Eigen::Vector2d position = Eigen::Vector2d::Zero();  // Of the target's centre, sensor px.
  };

  Status Tell(const std::function<bool(double)>& progress) {
    ++handled_;
    if (!progress || progress(static_cast<double>(handled_) / static_cast<double>(result_.frames.size()))) return {};
    return Cancelled("asked to stop");
  }

  void Report(int index, Outcome outcome, std::string reason) {
    FrameReport& report = result_.frames[static_cast<std::size_t>(index - request_.frame_begin)];
    report.outcome = outcome;
    report.reason = std::move(reason);
  }

  bool Usable(int index, const TargetFrame& frame) {
    if (!frame.skip_reason.empty()) Report(index, Outcome::kSkipped, frame.skip_reason);
    return frame.skip_reason.empty();
  }

  FrameInput InputOf(int index, const TargetFrame& frame, const Roi& roi) const {
    FrameInput input;
    input.frame_index = index;
    input.roi = roi;
    input.pixels = Crop(frame.pixels, roi);
    input.weights = weights_;
    if (frame.weights.empty()) return input;
    const Image<float> own = Crop(frame.weights, roi);
    for (std::size_t i = 0; i < own.pixels().size(); ++i) {
      input.weights.pixels()[i] *= std::isfinite(own.pixels()[i]) ? own.pixels()[i] : 0.0F;
    }
    return input;
  }

  Status Begin(const TargetFrame& frame) {
    if (!frame.skip_reason.empty()) {
      return InvalidInput(fmt::format("frame {} {}; choose another frame to pick the target in", request_.reference, frame.skip_reason));
    }
    const FrameInput input = InputOf(request_.reference, frame, request_.roi_in_sensor);
    TREM_RETURN_IF_ERROR(CheckTexture(input.pixels, weights_, request_.roi_in_sensor, noise_sigma_));
    first_ = segment_.Begin(input, noise_sigma_);
    result_.segments.emplace_back();
    result_.segments[0].chain.push_back({request_.reference, first_, request_.roi_in_sensor});
    Report(request_.reference, Outcome::kStartedScene, {});
    return {};
  }

  // Goes back to the reference frame.
  void Restart(const TargetMotion& motion) {
    motion_ = motion;
    view_ = first_.view;
    position_ = CentreOf(request_.roi_in_sensor);
    turned_ = Eigen::Matrix2d::Identity();
    lost_ = 0;
  }

  // One frame on, the ground moving by `new_from_old`.
  Status Follow(int index, const TargetFrame& frame, const std::optional<Affine>& new_from_old) {
    motion_->Step(new_from_old);
    turned_ = motion_->camera().linear * turned_;
    const Eigen::Vector2d expected = motion_->position();
    const Eigen::Vector2d moved = expected - CentreOf(request_.roi_in_sensor);
    if (!(moved.norm() < 1e5)) {
      ++lost_;
      Report(index, Outcome::kLost, "the target is far outside the field of view");
      return {};
    }
    const Roi roi = Shifted(request_.roi_in_sensor, static_cast<int>(std::lround(moved.x())), static_cast<int>(std::lround(moved.y())));
    View view = view_;
    view.scene_from_sensor = ViewAt(expected);
    std::string why = OutOfView(roi);
    if (why.empty()) {
      const Attempt attempt = Try(InputOf(index, frame, roi), view, motion_->sigma_px(), lost_ == 0 ? kTracking : kFinding);
      why = attempt.judged.doubt;
      if (why.empty()) return Accept(attempt);
    }
    TREM_ASSIGN_OR_RETURN(const bool found, Search(index, frame, roi, view, &why));
    if (found) return {};
    ++lost_;
    Report(index, Outcome::kLost, why);
    return {};
  }

  // The last registered view carried to where the target's centre is at `position`, turned as the camera has turned since.
  PlanarMap ViewAt(const Eigen::Vector2d& position) const {
    Affine old_from_new;
    old_from_new.linear = turned_.inverse();
    old_from_new.offset = position_ - old_from_new.linear * position;
    return view_.scene_from_sensor * old_from_new;
  }

  std::string OutOfView(const Roi& roi) const {
    const double inside = static_cast<double>(Intersect(roi, request_.sensor).area()) / static_cast<double>(roi.area());
    if (inside >= kInsideMin) return {};
    const Eigen::Vector2d past_low(request_.sensor.x0 - roi.x0, request_.sensor.y0 - roi.y0);
    const Eigen::Vector2d past_high(roi.x1 - request_.sensor.x1, roi.y1 - request_.sensor.y1);
    const double furthest = std::max(past_low.maxCoeff(), past_high.maxCoeff());
    const char* edge = furthest == past_low.x()    ? "left"
                       : furthest == past_high.x() ? "right"
                       : furthest == past_low.y()  ? "upper"
                                                   : "lower";
    return fmt::format("the target has left the field of view over its {} edge ({:.0f} % of it inside)", edge, 100.0 * inside);
  }

  Attempt Try(FrameInput input, const View& view, double place_sigma_px, const Strictness& strictness) {
    Segment::Expectation expectation;
    expectation.prior.mean = view;
    expectation.prior.information =
        PriorInformation(options_.view_model, std::max(place_sigma_px, 0.5), kShapeSigmaPx * std::sqrt(1.0 + lost_));
    expectation.prior.gain_sigma = 0.1;
    expectation.prior.offset_sigma = 15.0;
    expectation.motion_px_max = std::max(kGateMinPx, kGateSigmas * place_sigma_px);
    Attempt attempt;
    attempt.judged = segment_.RegisterFrame(input, noise_sigma_, expectation);
    attempt.position = attempt.judged.registration.view.scene_from_sensor.Inverse() * centre_in_scene_;
    attempt.input = std::move(input);
    if (attempt.judged.doubt.empty()) attempt.judged.doubt = Doubt(attempt, strictness);
    return attempt;
  }

  // Residual that is usual for this target, and correlation; nothing while too few frames have been seen.
  struct Usual {
    double residual = 0.0;
    double correlation = 0.0;
  };
  std::optional<Usual> UsualFit() const {
    if (residuals_.size() < kUsualMin) return std::nullopt;
    return Usual{std::max(Median(residuals_), noise_sigma_), Median(correlations_)};
  }

  std::string Doubt(const Attempt& attempt, const Strictness& strictness) const {
    const Registration& r = attempt.judged.registration;
    if (TooDeformed(r.view.scene_from_sensor, *attempt.input.roi, options_.ratio)) {
      return fmt::format("the target has turned or stretched too far from its picture in frame {}", request_.reference);
    }
    const std::optional<Usual> usual = UsualFit();
    const double correlation_min = std::max(strictness.correlation_min, usual ? usual->correlation - strictness.correlation_drop_max : 0.0);
    const double residual_max = strictness.residual_factor_max * (usual ? usual->residual : 1.5 * noise_sigma_);
    if (r.correlation < correlation_min && !(strictness.noise_excuses && r.residual_rms <= 1.2 * noise_sigma_)) {
      return fmt::format("does not match the target: correlation {:.2f} (at least {:.2f} needed)", r.correlation, correlation_min);
    }
    if (!usual) return {};
    const double hidden = HiddenPart(attempt, 4.0 * usual->residual);
    if (hidden > strictness.hidden_part_max) return fmt::format("{:.0f} % of the target are hidden or changed", 100.0 * hidden);
    if (r.residual_rms > residual_max) {
      return fmt::format("does not match the target: residual {:.1f} grey levels, usual are {:.1f}", r.residual_rms, usual->residual);
    }
    return {};
  }

  // Part of the target's own pixels whose residual is beyond `limit`.
  double HiddenPart(const Attempt& attempt, double limit) const {
    const Image<float> predicted = segment_.PredictFrame(attempt.judged.registration.view, *attempt.input.roi);
    long long seen = 0;
    long long beyond = 0;
    for (std::size_t i = 0; i < predicted.pixels().size(); ++i) {
      const float residual = attempt.input.pixels.pixels()[i] - predicted.pixels()[i];
      if (!std::isfinite(residual) || weights_.pixels()[i] < 0.5F) continue;
      ++seen;
      beyond += std::abs(residual) > limit ? 1 : 0;
    }
    return seen > 0 ? static_cast<double>(beyond) / static_cast<double>(seen) : 1.0;
  }

  Status Accept(const Attempt& attempt) {
    const Registration& registration = attempt.judged.registration;
    const int index = attempt.input.frame_index;
    TREM_RETURN_IF_ERROR(
        segment_.AddFrame(attempt.input, registration, noise_sigma_, [this](const SceneSnapshot& s) { return sink_(0, s); }));
    result_.segments[0].chain.push_back({index, registration, *attempt.input.roi});
    const double off_px = (attempt.position - motion_->position()).norm();
    Report(
        index, Outcome::kRegistered,
        lost_ == 0 ? std::string{} : fmt::format("found again after {} lost frames, {:.1f} px from where it was expected", lost_, off_px));
    motion_->Measure(attempt.position, std::max(0.1, std::sqrt(registration.corner_covariance.diagonal().maxCoeff())));
    view_ = registration.view;
    position_ = attempt.position;
    turned_ = Eigen::Matrix2d::Identity();
    lost_ = 0;
    Remember(registration);
    if (!first_velocity_ && segment_.frame_count() == 4) first_velocity_ = motion_->velocity();
    if (!options_.noise_known && segment_.frame_count() >= 4) {
      const double found = std::clamp(registration.residual_sigma, 0.3 * options_.noise_sigma, 6.0 * options_.noise_sigma);
      noise_sigma_ += 0.1 * (found - noise_sigma_);
    }
    return {};
  }

  void Remember(const Registration& registration) {
    residuals_.push_back(registration.residual_rms);
    correlations_.push_back(registration.correlation);
    if (residuals_.size() <= kUsualWindow) return;
    residuals_.erase(residuals_.begin());
    correlations_.erase(correlations_.begin());
  }

  // Looks for the target in the whole frame. `why` grows by what was seen when it is not found.
  Result<bool> Search(int index, const TargetFrame& frame, const Roi& roi, const View& view, std::string* why) {
    Image<float> picture = segment_.PredictFrame(view, roi);
    for (std::size_t i = 0; i < picture.pixels().size(); ++i) {
      if (weights_.pixels()[i] < 0.5F) picture.pixels()[i] = kNan;
    }
    const double gate_px = std::max(kGateMinPx, kGateSigmas * motion_->sigma_px());
    std::optional<Attempt> best;
    const std::vector<Sighting> sightings = FindPicture(picture, frame.pixels, kSightings);
    for (const Sighting& sighting : sightings) {
      if (sighting.correlation < kSightingMin) continue;
      const Eigen::Vector2d shift(sighting.x - roi.x0, sighting.y - roi.y0);
      const Eigen::Vector2d place = motion_->position() + shift;
      if (shift.norm() > gate_px) continue;
      View shifted = view;
      shifted.scene_from_sensor = ViewAt(place);
      Attempt attempt = Try(InputOf(index, frame, Shifted(roi, sighting.x - roi.x0, sighting.y - roi.y0)), shifted, 2.0, kFinding);
      if (!attempt.judged.doubt.empty()) continue;
      if (best && (best->position - attempt.position).norm() > 3.0) {
        *why += fmt::format("; two places look like it, at {:.0f},{:.0f} and {:.0f},{:.0f}", best->position.x(), best->position.y(),
                            attempt.position.x(), attempt.position.y());
        return false;
      }
      if (!best) best = std::move(attempt);
    }
    if (best) {
      TREM_RETURN_IF_ERROR(Accept(*best));
      return true;
    }
    if (!sightings.empty()) {
      const Eigen::Vector2d shift(sightings[0].x - roi.x0, sightings[0].y - roi.y0);
      *why += fmt::format("; the most similar place (correlation {:.2f}) is {:.0f} px from where it is expected, within {:.0f}",
                          sightings[0].correlation, shift.norm(), gate_px);
    }
    return false;
  }

  const TargetRequest& request_;
  const TargetFrames& frames_;
  const EngineOptions options_;
  const SnapshotSink& sink_;
  const Image<float> weights_;
  const Eigen::Vector2d centre_in_scene_;
  double noise_sigma_;
  Segment segment_;
  EngineResult result_;
  Registration first_;
  std::optional<TargetMotion> motion_;
  View view_;                                      // Of the last registered frame.
  Eigen::Vector2d position_;                       // Of the target's centre there.
  Eigen::Matrix2d turned_;                         // How the ground has turned and scaled since then.
  std::optional<Eigen::Vector2d> first_velocity_;  // Early in the forward pass: the backward pass starts with its opposite.
  std::vector<double> residuals_;                  // Of the last accepted registrations.
  std::vector<double> correlations_;
  int lost_ = 0;
  int handled_ = 0;
};

Status CheckRequest(const TargetRequest& request) {
  if (request.roi_in_sensor.empty() || !request.sensor.Contains(request.roi_in_sensor)) {
    return InvalidInput("ROI " + ToString(request.roi_in_sensor) + " is not inside the sensor " + ToString(request.sensor) +
                        "; choose one that is");
  }
  if (request.reference < request.frame_begin || request.reference >= request.frame_end) {
    return InvalidInput(
        fmt::format("the reference frame {} is not one of the frames {}:{}", request.reference, request.frame_begin, request.frame_end));
  }
  return {};
}

}  // namespace

Image<float> TargetWeights(int width, int height) {
  constexpr double kInner = 0.85;
  constexpr double kOuter = 1.2;
  constexpr double kLeast = 0.05;
  Image<float> weights(width, height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const double radius = std::hypot((2.0 * x + 1.0) / width - 1.0, (2.0 * y + 1.0) / height - 1.0);
      const double out = std::clamp((radius - kInner) / (kOuter - kInner), 0.0, 1.0);
      weights.at(x, y) = static_cast<float>(kLeast + (1.0 - kLeast) * 0.5 * (1.0 + std::cos(std::numbers::pi * out)));
    }
  }
  return weights;
}

Result<EngineResult> RunTarget(const TargetRequest& request, const TargetFrames& frames, const EngineOptions& options,
                               const SnapshotSink& sink, const std::function<bool(double)>& progress) {
  TREM_RETURN_IF_ERROR(CheckEngine(request.roi_in_sensor, options));
  TREM_RETURN_IF_ERROR(CheckRequest(request));
  TREM_ASSIGN_OR_RETURN(const SeparablePsf psf, MakePsf(options.psf, options.ratio));
  return TargetRun(request, frames, options, psf, sink).Run(progress);
}

}  // namespace trem
