#include "worker/tre/mapping_engine.h"

#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <numbers>

#include "worker/tre/frame_check.h"
#include "worker/tre/segment.h"
#include "worker/tre/sensor_corrections.h"

namespace trem {
namespace {

// Frames that a segment shares with the one before it, so that alignment can tie the two scene planes exactly.
constexpr std::size_t kSharedFrames = 6;
// Frames in a row that may be lost before the scene is given up.
constexpr int kLostFramesMax = 4;

// Why a view no longer suits its scene plane (nothing: it does): turned or stretched too far for the grid's sampling.
bool TooDeformed(const PlanarMap& scene_from_sensor, const Roi& roi, int ratio) {
  const Eigen::Vector2d centre(0.5 * (roi.x0 + roi.x1 - 1), 0.5 * (roi.y0 + roi.y1 - 1));
  const Eigen::Matrix2d relative = scene_from_sensor.LinearisedAt(centre).linear / ratio;
  const Eigen::JacobiSVD<Eigen::Matrix2d> svd(relative);
  const double largest = svd.singularValues()(0);
  const double smallest = svd.singularValues()(1);
  const double turned = std::abs(std::atan2(relative(1, 0) - relative(0, 1), relative(0, 0) + relative(1, 1)));
  return turned > 30.0 * std::numbers::pi / 180.0 || largest > 1.3 || smallest < 1.0 / 1.3;
}

// A frame whose residual is this many times what the scene's frames leave, and what noise alone leaves, shows something else: two scenes
// in one picture (a dissolve), smear, a torn frame.
constexpr double kResidualFactor = 2.5;
constexpr double kResidualSigmas = 3.0;
constexpr double kMedianFactor = 1.2;
// Frames after which a scene's own residual is known.
constexpr int kResidualFrames = 4;
// Correlation from which a frame is believed to continue what the frame before it began.
constexpr double kContinuesMin = 0.8;
// Change of brightness between frames that is worth a note: a factor, or grey levels at the middle of the range.
constexpr double kGainNote = 1.3;
constexpr double kShiftNote = 25.0;
constexpr double kMiddleGrey = 128.0;
// Part of the pixels masked as moving that is worth a note.
constexpr double kMaskedNote = 0.002;

template <typename... Values>
std::string Format(const char* format, Values... values) {
  char text[200];
  std::snprintf(text, sizeof text, format, values...);
  return text;
}

// Runs segments one after the other over the frames of a window.
class MappingRun {
 public:
  MappingRun(const Roi& roi, std::span<const FrameInput> frames, const EngineOptions& options, SeparablePsf psf, const SnapshotSink& sink)
      : roi_(roi),
        frames_(frames),
        options_(options),
        psf_(std::move(psf)),
        sink_(sink),
        noise_sigma_(options.noise_sigma),
        corrections_(roi, options.detector_bias) {
    for (const FrameInput& frame : frames) result_.frames.push_back({frame.frame_index, FrameReport::Outcome::kSkipped, frame.skip_reason});
  }

  Result<EngineResult> Run(const std::function<bool(double)>& progress) {
    std::size_t furthest = 0;
    for (std::size_t k = 0; k < frames_.size();) {
      furthest = std::max(furthest, k);
      if (progress && !progress(static_cast<double>(furthest) / static_cast<double>(frames_.size()))) return Cancelled("asked to stop");
      TREM_ASSIGN_OR_RETURN(k, Step(k));
    }
    if (segment_ != nullptr) TREM_RETURN_IF_ERROR(EndSegment());
    result_.noise_sigma = noise_sigma_;
    if (masked_part() > kMaskedNote)
      AddNote("movers_masked", Format("%.1f %% of the pixels show what moves, and were not used", 100.0 * masked_part()));
    AddNote("detector_bias", corrections_.BiasNote());
    result_.bad_pixels = corrections_.bad_pixels();
    AddNote("bad_pixels", corrections_.BadPixelNote());
    std::stable_sort(result_.notes.begin(), result_.notes.end(),
                     [](const EngineNote& a, const EngineNote& b) { return a.frame_index < b.frame_index; });
    return std::move(result_);
  }

 private:
  // Makes `out` of frame k; returns why it cannot be used (empty: it can).
  std::string Prepare(std::size_t k, FrameInput* out) const {
    *out = frames_[k];
    if (!out->skip_reason.empty()) return out->skip_reason;
    DropImpossible(&out->pixels);
    out->skip_reason = WhyUnusable(*out, noise_sigma_);
    if (!out->skip_reason.empty()) return out->skip_reason;
    std::size_t before = k;
    while (before > 0 && !frames_[before - 1].skip_reason.empty()) --before;
    if (before > 0 && Repeats(frames_[k].pixels, frames_[before - 1].pixels, noise_sigma_)) {
      out->skip_reason = "repeats the frame before it, up to its encoding";
      out->previous_from_current = Affine{};
    }
    corrections_.Correct(out);
    return out->skip_reason;
  }

  // Handles frame k; returns the frame to go on with (an earlier one when a new segment begins with shared frames).
  Result<std::size_t> Step(std::size_t k) {
    if (!frames_[k].skip_reason.empty()) return k + 1;
    if (const std::string reason = Prepare(k, &frame_); !reason.empty()) {
      Report(k, FrameReport::Outcome::kSkipped, reason);
      if (segment_ != nullptr) segment_->SkipFrame(frame_);
      return k + 1;
    }
    if (segment_ == nullptr) {
      StartSegment(k);
      return k + 1;
    }
    // A camera that hops on by most of its ROI a frame, as one that takes photographs does, begins a scene with each.
    if (segment_->HasMovedOff(frame_, Segment::Expected::kAtWorst)) return BeginNext(k);
    const JudgedRegistration judged = segment_->RegisterFrame(frame_, noise_sigma_);
    if (!judged.doubt.empty()) return segment_->HasMovedOff(frame_, Segment::Expected::kAsMeasured) ? BeginNext(k) : Lose(k, judged.doubt);
    const double residual = judged.registration.residual_rms;
    if (segment_->frame_count() > kResidualFrames && IsUnlike(judged.registration)) {
      return Lose(k,
                  Format("shows something else than the scene: residual %.1f grey levels where %.1f are usual", residual, usual_residual_));
    }
    if (TooDeformed(judged.registration.view.scene_from_sensor, roi_, options_.ratio) && k > segment_start_ + 1) return Rebase(k);
    NoteBrightness(judged.registration.view);
    TREM_RETURN_IF_ERROR(segment_->AddFrame(frame_, judged.registration, noise_sigma_, [this](const SceneSnapshot& s) { return Emit(s); }));
    result_.segments.back().chain.push_back({frame_.frame_index, judged.registration});
    TakeRevisedViews();
    lost_ = 0;
    corrections_.Learn(frame_, segment_->residual(), judged.registration.view, noise_sigma_);
    if (result_.segments.size() == 1 && !segment_->has_emitted() && corrections_.WorthRevisiting()) return BeginAgain();
    const int known = std::min(segment_->frame_count() - 1, 10);
    usual_residual_ += (residual - usual_residual_) / known;
    usual_sigma_ += (judged.registration.residual_sigma - usual_sigma_) / known;
    if (result_.frames[k].outcome != FrameReport::Outcome::kStartedScene) Report(k, FrameReport::Outcome::kRegistered, {});
    if (!options_.noise_known && segment_->frame_count() >= 4) {
      // A slow average of the residuals' robust spread, kept near the first guess so that a hard passage cannot run away with it.
      const double found = std::clamp(judged.registration.residual_sigma, 0.3 * options_.noise_sigma, 6.0 * options_.noise_sigma);
      noise_sigma_ += 0.1 * (found - noise_sigma_);
    }
    return k + 1;
  }

  // The detector's faults are known now: the first scene, which holds them, is made again from its first frame.
  std::size_t BeginAgain() {
    segment_.reset();
    result_.segments.clear();
    result_.notes.clear();
    return segment_start_;
  }

  void AddNote(const std::string& code, const std::string& text) {
    if (!text.empty()) result_.notes.push_back({code, -1, text});
  }

  double masked_part() const {
    return result_.used_pixels > 0 ? static_cast<double>(result_.masked_pixels) / static_cast<double>(result_.used_pixels) : 0.0;
  }

  // Whether a registered frame leaves much more than the scene's frames do, and all over the ROI: what only moves in it leaves the median.
  bool IsUnlike(const Registration& registration) const {
    return registration.residual_rms > std::max(kResidualFactor * usual_residual_, kResidualSigmas * noise_sigma_) &&
           registration.residual_sigma > kMedianFactor * std::max(usual_sigma_, noise_sigma_);
  }

  void NoteBrightness(const View& view) {
    const View& before = segment_->view();
    const double factor = view.gain / before.gain;
    const double shift = view.gain * kMiddleGrey + view.offset - before.gain * kMiddleGrey - before.offset;
    if (factor < kGainNote && factor > 1.0 / kGainNote && std::abs(shift) < kShiftNote) return;
    const EngineNote note{"brightness_jump", frame_.frame_index,
                          Format("brightness jumps: contrast times %.2f, middle grey %+.0f levels", factor, shift)};
    // A frame that is shared by two segments is noted once.
    const bool known = std::any_of(result_.notes.begin(), result_.notes.end(), [&note](const EngineNote& other) {
      return other.code == note.code && other.frame_index == note.frame_index;
    });
    if (!known) result_.notes.push_back(note);
  }

  // Frame k, prepared in frame_, is the first of a new scene.
  void StartSegment(std::size_t k) {
    segment_ = std::make_unique<Segment>(roi_, psf_, options_, static_cast<std::uint64_t>(result_.segments.size()));
    result_.segments.emplace_back();
    result_.segments.back().chain.push_back({frame_.frame_index, segment_->Begin(frame_, noise_sigma_)});
    segment_start_ = k;
    lost_ = 0;
    usual_residual_ = usual_sigma_ = 0.0;
    corrections_.BreakTrack();
    if (result_.frames[k].outcome != FrameReport::Outcome::kRegistered) Report(k, FrameReport::Outcome::kStartedScene, {});
  }

  // Ends the segment before frame k, prepared in frame_, and begins the next one with it.
  Result<std::size_t> BeginNext(std::size_t k) {
    TREM_RETURN_IF_ERROR(EndSegment());
    StartSegment(k);
    return k + 1;
  }

  Result<std::size_t> Lose(std::size_t k, const std::string& reason) {
    segment_->SkipFrame(frame_);
    if (IsCut(k)) {
      result_.notes.push_back(
          {"cut", frame_.frame_index, "another scene begins: the frame and the next fit each other and not what was before"});
      return BeginNext(k);
    }
    if (++lost_ <= kLostFramesMax) {
      Report(k, FrameReport::Outcome::kLost, reason);
      return k + 1;
    }
    // The scene is not coming back: the lost frames are tried again on a scene of their own.
    std::size_t again = k;
    while (again > segment_start_ + 1 &&
           (result_.frames[again - 1].outcome == FrameReport::Outcome::kLost || !frames_[again - 1].skip_reason.empty()))
      --again;
    TREM_RETURN_IF_ERROR(EndSegment());
    return again;
  }

  // True when the frame after k (which is lost, skipped, and in frame_) does not fit the scene either, but fits a scene that begins with
  // frame k as well as frames of one scene do. A frame of a dissolve begins nothing: it fits neither what was nor what comes.
  bool IsCut(std::size_t k) const {
    FrameInput next;
    std::size_t after = k + 1;
    while (after < frames_.size() && !Prepare(after, &next).empty()) ++after;
    if (after >= frames_.size() || after > k + static_cast<std::size_t>(kLostFramesMax)) return false;
    const JudgedRegistration old = segment_->RegisterFrame(next, noise_sigma_);
    if (old.doubt.empty() && !IsUnlike(old.registration)) return false;
    Segment trial(roi_, psf_, options_, static_cast<std::uint64_t>(result_.segments.size()));
    trial.Begin(frame_, noise_sigma_);
    const JudgedRegistration fresh = trial.RegisterFrame(next, noise_sigma_);
    return fresh.doubt.empty() && fresh.registration.correlation >= kContinuesMin && !IsUnlike(fresh.registration);
  }

  // Ends the segment before frame k and begins the next one a few registered frames earlier.
  Result<std::size_t> Rebase(std::size_t k) {
    std::size_t again = k;
    for (std::size_t shared = 0; shared < kSharedFrames && again > segment_start_ + 1;) {
      --again;
      if (frames_[again].skip_reason.empty()) ++shared;
    }
    TREM_RETURN_IF_ERROR(EndSegment());
    return again;
  }

  // Views that the scheme has improved afterwards stand in the chain in their improved form.
  void TakeRevisedViews() {
    std::vector<ChainEntry>& chain = result_.segments.back().chain;
    for (const ChainEntry& revised : segment_->TakeRevised()) {
      for (auto entry = chain.rbegin(); entry != chain.rend(); ++entry) {
        if (entry->frame_index != revised.frame_index) continue;
        entry->registration = revised.registration;
        break;
      }
    }
  }

  Status EndSegment() {
    result_.masked_pixels += segment_->masked();
    result_.used_pixels += static_cast<long long>(segment_->frame_count()) * roi_.area();
    const Status status = segment_->End(noise_sigma_, [this](const SceneSnapshot& s) { return Emit(s); });
    segment_.reset();
    return status;
  }

  Status Emit(SceneSnapshot snapshot) {
    snapshot.scene_id = scene_count_++;
    return sink_(static_cast<int>(result_.segments.size()) - 1, snapshot);
  }

  void Report(std::size_t k, FrameReport::Outcome outcome, const std::string& reason) {
    result_.frames[k].outcome = outcome;
    result_.frames[k].reason = reason;
  }

  Roi roi_;
  std::span<const FrameInput> frames_;
  EngineOptions options_;
  SeparablePsf psf_;
  const SnapshotSink& sink_;
  double noise_sigma_;
  EngineResult result_;
  FrameInput frame_;  // The one that is being handled, as it is used.
  std::unique_ptr<Segment> segment_;
  std::size_t segment_start_ = 0;
  double usual_residual_ = 0.0;  // Running means of the segment's residual_rms and residual_sigma; 0: not known yet.
  double usual_sigma_ = 0.0;
  SensorCorrections corrections_;
  int lost_ = 0;
  int scene_count_ = 0;
};

}  // namespace

Status CheckEngine(const Roi& roi, const EngineOptions& options) {
  if (roi.width() < 16 || roi.height() < 16) {
    return InvalidInput("ROI " + ToString(roi) + " is too small to register; at least 16 x 16 sensor pixels are needed");
  }
  if (options.ratio < 2 || options.ratio > 4) return InvalidInput("tre.ratio is " + std::to_string(options.ratio) + "; expected 2, 3 or 4");
  if (!(options.noise_sigma > 0.0)) return InvalidInput("the noise sigma is " + std::to_string(options.noise_sigma) + "; expected > 0");
  return {};
}

Result<EngineResult> RunMapping(const Roi& roi_in_sensor, std::span<const FrameInput> frames, const EngineOptions& options,
                                const SnapshotSink& sink, const std::function<bool(double)>& progress) {
  TREM_RETURN_IF_ERROR(CheckEngine(roi_in_sensor, options));
  TREM_ASSIGN_OR_RETURN(SeparablePsf psf, MakePsf(options.psf, options.ratio));
  return MappingRun(roi_in_sensor, frames, options, std::move(psf), sink).Run(progress);
}

}  // namespace trem
