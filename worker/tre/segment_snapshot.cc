// What a segment leaves of its scene.
#include "worker/tre/close_gaps.h"
#include "worker/tre/emitted_band.h"
#include "worker/tre/segment.h"

namespace trem {
namespace {

// Iterations before a snapshot.
constexpr int kSnapshotIterations = 12;
// Cells seen by less than this many frames hold mostly invented values: left out of snapshots.
constexpr float kSeenMin = 0.4F;

}  // namespace

Status Segment::EmitSnapshot(double noise_sigma, const Emit& emit) {
  // Cells that came into the buffer beside seen ones, or lost neighbours to a move, have a stale count: it is the steps' majoriser.
  update_.UpdateSeen(buffer_.extent, options_.ratio, &buffer_);
  if (scheme_ == nullptr || scheme_->remembers()) {
    Iterate(buffer_.extent, kSnapshotIterations, regularisation_.Weight(buffer_.extent, buffer_, noise_sigma));
  }
  SceneSnapshot snapshot;
  snapshot.extent = buffer_.extent;
  snapshot.intensity = InEmittedBand(buffer_.scene);
  snapshot.information = CloseGaps(buffer_.seen, kSeenMin, options_.ratio);
  snapshot.frame_begin = first_unemitted_;
  snapshot.frame_end = last_added_ + 1;
  if (options_.uncertainty) AddUncertainty(noise_sigma, &snapshot);
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

void Segment::AddUncertainty(double noise_sigma, SceneSnapshot* snapshot) {
  UncertaintyOptions options;
  options.seed = options_.seed ^ (segment_id_ << 32U);
  options.threads = options_.threads;
  snapshot->residual = residuals_.Rms(options_.ratio);
  const StructureWeight weight = regularisation_.Weight(buffer_.extent, buffer_, noise_sigma);
  const StructurePrior prior{options_.structure, weight.delta};
  const float lambda = static_cast<float>(options_.structure_weight) * weight.lambda;
  snapshot->sigma = SceneSigma(buffer_, snapshot->residual, update_.psf(), prior, lambda, noise_sigma, options);
}

Status Segment::End(double noise_sigma, const Emit& emit) { return EmitSnapshot(noise_sigma, emit); }

}  // namespace trem
