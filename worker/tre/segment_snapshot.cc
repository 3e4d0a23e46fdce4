// What a segment leaves of its scene.
#include <cmath>
#include <optional>

#include "worker/tre/close_gaps.h"
#include "worker/tre/emitted_band.h"
#include "worker/tre/held_out_weight.h"
#include "worker/tre/segment.h"

namespace trem {
namespace {

// Iterations before a snapshot; then on the scene that is handed out, first under a part of the structure weight, then under all of it.
constexpr int kSnapshotIterations = 12;
constexpr int kSharpenIterations = 110;
constexpr float kSharpenPart = 0.2F;
constexpr int kPolishIterations = 60;
// Kept frames from which accumulators are made anew; and from which frames are held out, one in so many.
constexpr std::size_t kPolishFrames = 4;
constexpr std::size_t kHoldOutFrames = 8;
constexpr std::size_t kHoldEvery = 5;
// Cells seen by less than this many frames hold mostly invented values: left out of snapshots.
constexpr float kSeenMin = 0.4F;

}  // namespace

Status Segment::EmitSnapshot(double noise_sigma, const Emit& emit) {
  // Cells that came into the buffer beside seen ones, or lost neighbours to a move, have a stale count: it is the steps' majoriser.
  update_.UpdateSeen(buffer_.extent, options_.ratio, &buffer_);
  emitted_weight_ = regularisation_.Weight(buffer_.extent, buffer_, noise_sigma);
  if (scheme_ == nullptr || scheme_->remembers()) Iterate(buffer_.extent, kSnapshotIterations, emitted_weight_);
  std::optional<SceneBuffer> polished;
  if (kept_ && kept_->size() >= kPolishFrames) polished = Polished(noise_sigma);
  const SceneBuffer& made = polished ? *polished : buffer_;
  SceneSnapshot snapshot;
  snapshot.extent = made.extent;
  snapshot.intensity = InEmittedBand(made.scene);
  snapshot.information = CloseGaps(made.seen, kSeenMin, options_.ratio);
  snapshot.frame_begin = first_unemitted_;
  snapshot.frame_end = last_added_ + 1;
  if (options_.uncertainty) AddUncertainty(made, noise_sigma, &snapshot);
  for (std::size_t i = 0; i < snapshot.information.pixels().size(); ++i) {
    if (snapshot.information.pixels()[i] >= kSeenMin) continue;
    snapshot.information.pixels()[i] = 0.0F;
    snapshot.intensity.pixels()[i] = 0.0F;
    if (!options_.uncertainty) continue;
    snapshot.sigma.pixels()[i] = 0.0F;
    snapshot.residual.pixels()[i] = 0.0F;
  }
  first_unemitted_ = last_added_ + 1;
  has_emitted_ = true;
  return emit(snapshot);
}

SceneBuffer Segment::Polished(double noise_sigma) {
  const bool hold_out = kept_->size() >= kHoldOutFrames;
  SceneBuffer made = buffer_;
  Accumulated sums = kept_->Accumulate(made, hold_out ? kHoldEvery : 0);
  StructureWeight weight = emitted_weight_;
  weight.lambda *= static_cast<float>(std::exp(emitted_log_factor_));
  update_.set_prior({options_.structure, weight.delta});
  if (hold_out) {
    const HeldOutWeight found = FindHeldOutWeight(*kept_, sums, weight, options_.ratio, noise_sigma, made, &update_);
    emitted_log_factor_ += found.log_factor;
    weight.lambda *= static_cast<float>(std::exp(found.log_factor));
    for (std::size_t k = 0; k < sums.weight.pixels().size(); ++k) {
      sums.weight.pixels()[k] += sums.held_weight.pixels()[k];
      sums.weighted.pixels()[k] += sums.held_weighted.pixels()[k];
    }
  }
  made.weight = std::move(sums.weight);
  made.weighted = std::move(sums.weighted);
  update_.UpdateSeen(made.extent, options_.ratio, &made);
  emitted_weight_ = weight;
  const float lambda = static_cast<float>(options_.structure_weight) * weight.lambda;
  // What the prior holds back longest is found fast without it, and what is too much of that is taken back fast with it.
  update_.Converge(made.extent, kSharpenIterations, kSharpenPart * lambda, &made);
  update_.Converge(made.extent, kPolishIterations, lambda, &made);
  return made;
}

void Segment::AddUncertainty(const SceneBuffer& made, double noise_sigma, SceneSnapshot* snapshot) {
  UncertaintyOptions options;
  options.seed = options_.seed ^ (segment_id_ << 32U);
  options.threads = options_.threads;
  snapshot->residual = residuals_.Rms(options_.ratio);
  const StructurePrior prior{options_.structure, emitted_weight_.delta};
  const float lambda = static_cast<float>(options_.structure_weight) * emitted_weight_.lambda;
  snapshot->sigma = SceneSigma(made, snapshot->residual, update_.psf(), prior, lambda, noise_sigma, options);
}

Status Segment::End(double noise_sigma, const Emit& emit) { return EmitSnapshot(noise_sigma, emit); }

}  // namespace trem
