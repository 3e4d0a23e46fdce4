#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <string>

#include "mosaic/base/image.h"
#include "mosaic/base/status.h"
#include "tests/bench/score/fidelity.h"
#include "tests/bench/score/substitution.h"

namespace trem::score {

struct ScoreOptions {
  int patch_px = 56;      // Side of a patch, sensor pixels.
  double search_m = 0.0;  // How far off the whole mosaic may be. 0: 12 sensor pixels, at least twice the GPS bias + 2 m.
};

struct Score {
  double coverage = 0.0;  // Of the ground seen by some frame, less 3 sensor pixels at the border.
  // Absolute position: mosaic - truth.
  double shift_e_m = 0.0;
  double shift_n_m = 0.0;
  double absolute_error_m = 0.0;
  double gps_bias_e_m = 0.0;
  double gps_bias_n_m = 0.0;
  double gps_bias_m = 0.0;
  // Distance of the patches' shifts from the one global shift, sensor pixels. Textured patches that match nowhere count as the search
  // radius.
  double distortion_median_px = 0.0;
  double distortion_p95_px = 0.0;
  int patch_count = 0;    // Textured ones.
  int matched_count = 0;  // Of them.
  // Against the truth filtered by [1 2 1]/4 on the 3:1 grid, moved by the global shift, on the pixels where both have a value.
  Fidelity mosaic;
  Fidelity bicubic;
  Evenness evenness;     // Of the mosaic, over blocks of 8 sensor pixels.
  double gain_db = 0.0;  // mosaic.psnr_db - bicubic.psnr_db.
  double sensor_gsd_m = 0.0;
  double mosaic_gsd_m = 0.0;
  long long pixel_count = 0;
};

// Everything that a picture needs, on the mosaic's grid; NaN outside the compared pixels, all in the truth's grey levels.
struct Compared {
  Image<float> truth;
  Image<float> bicubic;
  Image<float> mosaic;
};

// Scores a mosaic against the simulation it was made from. kFailed when it cannot be matched to the truth at all. `compared` may be null.
Result<Score> ScoreMosaic(const std::filesystem::path& simulation, const std::filesystem::path& mosaic, const ScoreOptions& options,
                          Compared* compared);

// truth | bicubic | mosaic at the most detailed places, one row each, enlarged. kInvalidInput when there is no compared pixel.
Status WritePicture(const Compared& compared, const std::filesystem::path& path);

std::string ToTable(const Score& score);
// `substitution` may be null.
std::string ToJson(const Score& score, const Substitution* substitution);

}  // namespace trem::score
