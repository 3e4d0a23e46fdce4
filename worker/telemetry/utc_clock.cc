#include "worker/telemetry/utc_clock.h"

#include <algorithm>
#include <cmath>

namespace trem {
namespace {

constexpr double kMicrosecondsPerSecond = 1e6;
// Farther than this beyond the records nothing is said: the clock is not known to have run on.
constexpr double kBeyondMost_s = 86400.0;

}  // namespace

std::optional<std::int64_t> PlausibleUtc(std::int64_t utc_us) {
  if (utc_us < kUtcLeast_us || utc_us > kUtcMost_us) return std::nullopt;
  return utc_us;
}

UtcClock::UtcClock(const std::vector<TelemetryRecord>& records) {
  for (const TelemetryRecord& record : records) {
    const std::optional<std::int64_t> utc_us = record.utc_us.has_value() ? PlausibleUtc(*record.utc_us) : std::nullopt;
    if (!utc_us.has_value()) continue;
    if (!readings_.empty() && *utc_us < readings_.back().utc_us) {
      readings_.clear();
      return;
    }
    readings_.push_back({record.time_s, *utc_us});
  }
}

std::optional<std::int64_t> UtcClock::At(double time_s) const {
  if (readings_.empty()) return std::nullopt;
  const auto after =
      std::upper_bound(readings_.begin(), readings_.end(), time_s, [](double t, const Reading& reading) { return t < reading.time_s; });
  const Reading& from = after == readings_.begin() ? *after : *(after - 1);
  const double since_s = time_s - from.time_s;
  double gone_us = kMicrosecondsPerSecond * since_s;
  if (after == readings_.begin() || after == readings_.end()) {
    if (!(std::abs(since_s) <= kBeyondMost_s)) return std::nullopt;
  } else {
    gone_us = since_s / (after->time_s - from.time_s) * static_cast<double>(after->utc_us - from.utc_us);
  }
  return PlausibleUtc(from.utc_us + static_cast<std::int64_t>(std::llround(gone_us)));
}

}  // namespace trem
