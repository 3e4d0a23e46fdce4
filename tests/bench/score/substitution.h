#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "tests/bench/score/fidelity.h"

namespace trem::score {

// A mosaic of the run's scenes with something put right from the truth.
struct Substitute {
  std::string what;
  Fidelity fidelity;
};

struct Placement {
  std::size_t scene_count = 0;
  // Error of the scenes' centres, aligned - true: rms of one axis [m], and what is left of it without the mean of all.
  double error_m = 0.0;
  double relative_error_m = 0.0;
  double sigma_m = 0.0;  // Rms of the standard errors that the alignment states.
  // Part of all axes of all scenes within one and two stated standard errors; 0.683 and 0.954 when they are right.
  double within_one_sigma = 0.0;
  double within_two_sigma = 0.0;
};

struct Substitution {
  // The median of the same scenes placed with the true transforms, gains and offsets as the alignment found them.
  Fidelity truly_placed;
  std::vector<Substitute> others;
  Placement placement;
};

// Where a mosaic's quality is lost: composes the scenes of a kept run (trem run --keep-work) again with the truth in place of what the
// alignment found. With `all` further substitutes besides the true transforms.
Result<Substitution> CompareSubstitutes(const std::filesystem::path& simulation, const std::filesystem::path& work, bool all);

std::string ToTable(const Substitution& substitution);

}  // namespace trem::score
