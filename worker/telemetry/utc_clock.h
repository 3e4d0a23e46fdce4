#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "worker/telemetry/telemetry_record.h"

namespace trem {

// Times since 1970 below this count from the start of a recording, and those above kUtcMost_us are beyond the year 9999.
inline constexpr std::int64_t kUtcLeast_us = 100'000'000'000'000;
inline constexpr std::int64_t kUtcMost_us = 253'402'300'799'000'000;

// `utc_us` when it is a time in 1973..9999.
std::optional<std::int64_t> PlausibleUtc(std::int64_t utc_us);

// What the clock on the wall shows while a recording runs: UTC as a function of the time of telemetry records.
class UtcClock {
 public:
  UtcClock() = default;
  // `records` in the order of time_s; those without a plausible utc_us tell nothing. UTC that runs backward anywhere is not believed at
  // all.
  explicit UtcClock(const std::vector<TelemetryRecord>& records);

  // Microseconds since 1970 at `time_s` of the records' clock: linear between records; before the first and after the last a second
  // takes a second. Nothing when no record told a time.
  std::optional<std::int64_t> At(double time_s) const;

 private:
  struct Reading {
    double time_s;
    std::int64_t utc_us;
  };
  std::vector<Reading> readings_;
};

}  // namespace trem
