#include "worker/tre/mapping_engine.h"

#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>

#include "worker/sensor/bicubic.h"
#include "worker/tre/segment.h"

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

// Runs segments one after the other over the frames of a window.
class MappingRun {
 public:
  MappingRun(const Roi& roi, std::span<const FrameInput> frames, const EngineOptions& options, SeparablePsf psf, const SnapshotSink& sink)
      : roi_(roi), frames_(frames), options_(options), psf_(std::move(psf)), sink_(sink), noise_sigma_(options.noise_sigma) {
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
    return std::move(result_);
  }

 private:
  // Handles frame k; returns the frame to go on with (an earlier one when a new segment begins with shared frames).
  Result<std::size_t> Step(std::size_t k) {
    const FrameInput& frame = frames_[k];
    if (!frame.skip_reason.empty()) return k + 1;
    if (segment_ == nullptr) {
      StartSegment(k);
      return k + 1;
    }
    const JudgedRegistration judged = segment_->RegisterFrame(frame, noise_sigma_);
    if (!judged.doubt.empty()) return Lose(k, judged.doubt);
    if (TooDeformed(judged.registration.view.scene_from_sensor, roi_, options_.ratio) && k > segment_start_ + 1) return Rebase(k);
    TREM_RETURN_IF_ERROR(segment_->AddFrame(frame, judged.registration, noise_sigma_, [this](const SceneSnapshot& s) { return Emit(s); }));
    result_.segments.back().chain.push_back({frame.frame_index, judged.registration});
    lost_ = 0;
    if (result_.frames[k].outcome != FrameReport::Outcome::kStartedScene) Report(k, FrameReport::Outcome::kRegistered, {});
    if (!options_.noise_known && segment_->frame_count() >= 4) {
      // A slow average of the residuals' robust spread, kept near the first guess so that a hard passage cannot run away with it.
      const double found = std::clamp(judged.registration.residual_sigma, 0.3 * options_.noise_sigma, 6.0 * options_.noise_sigma);
      noise_sigma_ += 0.1 * (found - noise_sigma_);
    }
    return k + 1;
  }

  void StartSegment(std::size_t k) {
    segment_ = std::make_unique<Segment>(roi_, psf_, options_, static_cast<std::uint64_t>(result_.segments.size()));
    result_.segments.emplace_back();
    result_.segments.back().chain.push_back({frames_[k].frame_index, segment_->Begin(frames_[k], noise_sigma_)});
    segment_start_ = k;
    lost_ = 0;
    if (result_.frames[k].outcome != FrameReport::Outcome::kRegistered) Report(k, FrameReport::Outcome::kStartedScene, {});
  }

  Result<std::size_t> Lose(std::size_t k, const std::string& reason) {
    if (++lost_ <= kLostFramesMax) {
      Report(k, FrameReport::Outcome::kLost, reason);
      segment_->SkipFrame(frames_[k]);
      return k + 1;
    }
    // The scene is not coming back: the lost frames are tried again on a scene of their own.
    std::size_t again = k;
    while (again > segment_start_ + 1 && (result_.frames[again - 1].outcome == FrameReport::Outcome::kLost || !frames_[again - 1].skip_reason.empty())) --again;
    TREM_RETURN_IF_ERROR(EndSegment());
    return again;
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

  Status EndSegment() {
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
  std::unique_ptr<Segment> segment_;
  std::size_t segment_start_ = 0;
  int lost_ = 0;
  int scene_count_ = 0;
};

Status CheckOptions(const Roi& roi, const EngineOptions& options) {
  if (roi.width() < 16 || roi.height() < 16) {
    return InvalidInput("ROI " + ToString(roi) + " is too small to register; at least 16 x 16 sensor pixels are needed");
  }
  if (options.ratio < 2 || options.ratio > 4) return InvalidInput("tre.ratio is " + std::to_string(options.ratio) + "; expected 2, 3 or 4");
  if (!(options.noise_sigma > 0.0)) return InvalidInput("the noise sigma is " + std::to_string(options.noise_sigma) + "; expected > 0");
  return {};
}

}  // namespace

Result<EngineResult> RunMapping(const Roi& roi_in_sensor, std::span<const FrameInput> frames, const EngineOptions& options,
                                const SnapshotSink& sink, const std::function<bool(double)>& progress) {
  TREM_RETURN_IF_ERROR(CheckOptions(roi_in_sensor, options));
  TREM_ASSIGN_OR_RETURN(SeparablePsf psf, MakePsf(options.psf, options.ratio));
  return MappingRun(roi_in_sensor, frames, options, std::move(psf), sink).Run(progress);
}

}  // namespace trem
