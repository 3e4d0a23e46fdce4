#pragma once

#include <chrono>
#include <cstdint>

namespace trem {

// Milliseconds since 1970, UTC. For what people read and for comparing clocks; durations belong to the steady clock.
inline std::uint64_t WallClockMs() {
  return static_cast<std::uint64_t>(
      std::chrono::duration_cast<std::chrono::milliseconds>(std::chrono::system_clock::now().time_since_epoch()).count());
}

}  // namespace trem
