#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "worker/registration/gauss_newton.h"

namespace trem {

// Part of a ROI that has to lie over seen scene for a registration to be believed.
inline constexpr double kRegistrationOverlapMin = 0.25;

enum class RegistrationMethod {
  kAuto,                  // Gauss-Newton; pyramids, then HINTS as capture, when the result fails validation.
  kGaussNewton,           // Gauss-Newton with pyramids only.
  kHints,                 // HINTS alone: the posterior mean of its draws.
  kHintsThenGaussNewton,  // HINTS as capture for every frame, then Gauss-Newton.
  kPairwise,              // The pairwise search: the baseline.
};

struct RegistrationRequest {
  ViewPrior prior;
  std::vector<View> candidates;  // Other places to start from when the prior's mean leads nowhere.
  RegistrationMethod method = RegistrationMethod::kAuto;
  GainOffset gain_offset = GainOffset::kMaximumLikelihood;
  // How far a corner may end from the prior's mean [sensor px] to be believed.
  double motion_px_max = 20.0;
  int threads = 1;                      // Of Gauss-Newton; the result does not depend on it.
  std::uint64_t stream[3] = {0, 0, 0};  // Key of the random stream: seed, window, frame.
};

// The registration and, when it cannot be believed, why (empty: it can).
struct JudgedRegistration {
  Registration registration;
  std::string doubt;
};

// Registers with the asked method and judges the result: enough overlap, residuals that the noise explains or a prediction that
// correlates with the frame, and a motion that the prior allows.
JudgedRegistration Register(const Observation& observation, const Reference& reference, const RegistrationRequest& request);

}  // namespace trem
