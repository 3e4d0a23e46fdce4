#pragma once

#include <hwy/highway.h>

#include <cstdint>
#include <cstdio>
#include <vector>

namespace trem::testing {

// The SIMD targets of this processor that have fused multiply-add, best first: those that must give the same bytes. Targets that the
// processor does not have are named on stdout as skipped.
inline std::vector<std::int64_t> FusedTargets() {
  std::vector<std::int64_t> targets;
  const std::int64_t here = hwy::SupportedTargets();
  for (const std::int64_t target : {static_cast<std::int64_t>(HWY_AVX3), static_cast<std::int64_t>(HWY_AVX2)}) {
    if ((HWY_TARGETS & target) == 0 || (here & target) == 0) {
      std::printf("skipped: target %s, which this processor or build does not have\n", hwy::TargetName(target));
    } else {
      targets.push_back(target);
    }
  }
  return targets;
}

// While it lives, dispatch goes to `target`.
class WithTarget {
 public:
  explicit WithTarget(std::int64_t target) { hwy::GetChosenTarget().Update(target); }
  ~WithTarget() { hwy::GetChosenTarget().Update(hwy::SupportedTargets()); }
  WithTarget(const WithTarget&) = delete;
  WithTarget& operator=(const WithTarget&) = delete;
};

}  // namespace trem::testing
