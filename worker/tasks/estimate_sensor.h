#pragma once

#include <functional>

#include "mosaic/base/status.h"
#include "proto/trem/v1/job.pb.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// Estimates the width of a Gaussian PSF when the spec gives none (sensor.psf_sigma_px 0), from up to two of the most textured places of 16
// successive frames (EstimatePsfSigma), weighs it against what sensors usually are, and writes it with its error and a note into manifest->sensor. Without confidence
// kPsfSigmaAssumed_px stays, and the note says why. manifest->noise_sigma is lowered to the residuals' spread of the best width when
// the spec gives no noise either: texture inflates what a single frame shows.
//
// Cost: under 10 % of the job's ENHANCE for sorties of about a hundred frames and more; nothing for less than 12 usable frames.
// Deterministic. `progress`: 0..1 of this step; false cancels.
Status EstimateSensor(const v1::Sortie& sortie, const std::function<bool(double)>& progress, v1::SortieManifest* manifest);

inline constexpr double kPsfSigmaAssumed_px = 0.55;

}  // namespace trem
