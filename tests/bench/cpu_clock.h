#pragma once

#include <ctime>

namespace trem::bench {

// CPU time of the calling thread [ms]: what work takes on a machine that has other work, too, but for what that does to the caches.
inline double ThreadCpuMs() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1e3 * static_cast<double>(now.tv_sec) + 1e-6 * static_cast<double>(now.tv_nsec);
}

}  // namespace trem::bench
