#pragma once

#include <functional>

#include "mosaic/base/status.h"
#include "proto/trem/v1/job.pb.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// Estimates the width of a Gaussian PSF when the spec gives none (sensor.psf_sigma_px 0), from the power spectrum of up to 16 frames spread
// over the sortie (EstimatePsfSigma), weighs it against what sensors usually are, and writes it with its error and a note into
// manifest->sensor. Without confidence kPsfSigmaAssumed_px stays, and the note says why. manifest->noise_sigma is lowered to the white noise
// of the spectrum when the spec gives no noise either: texture inflates what a single frame shows.
//
// Cost: reading those frames, and a fraction of a second. Deterministic. `progress`: 0..1 of this step; false cancels.
Status EstimateSensor(const v1::Sortie& sortie, const std::function<bool(double)>& progress, v1::SortieManifest* manifest);

inline constexpr double kPsfSigmaAssumed_px = 0.55;

}  // namespace trem
