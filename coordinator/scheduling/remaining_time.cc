#include "coordinator/scheduling/remaining_time.h"

#include <algorithm>
#include <cmath>

namespace trem {
namespace {

constexpr double kNormalQuantile90 = 1.2816;  // 80 % lie within, 10 % to either side.
constexpr double kGuessFactor = 2.0;

double StandardDeviation(const StageLoad& stage) {
  const double mean = stage.sum_ms / stage.done;
  if (stage.done < 2) return mean;
  return std::sqrt(std::max(0.0, (stage.sum_ms2 - stage.done * mean * mean) / (stage.done - 1)));
}

RemainingTime Of(const StageLoad& stage, double guess_ms, std::uint32_t worker_count) {
  // Not unfolded yet: assume that it spreads over all workers.
  if (stage.total == 0) return {guess_ms / worker_count, guess_ms / worker_count / kGuessFactor, guess_ms / worker_count * kGuessFactor};
  const double unfinished = static_cast<double>(stage.total) - stage.done - stage.given_up;
  const double left = std::max(0.0, unfinished - stage.running_fraction);
  const double side_by_side = std::max(1.0, std::min<double>(worker_count, unfinished));
  if (stage.done == 0) {
    const double ms = left * guess_ms / stage.total / side_by_side;
    return {ms, ms / kGuessFactor, ms * kGuessFactor};
  }
  const double mean_ms = stage.sum_ms / stage.done;
  const double ms = left * mean_ms / side_by_side;
  const double half_ms = kNormalQuantile90 * StandardDeviation(stage) * std::sqrt(left + left * left / stage.done) / side_by_side;
  const double tail_ms = left > 0.0 ? mean_ms * (side_by_side - 1.0) / side_by_side : 0.0;
  return {ms, std::max(0.0, ms - half_ms), ms + half_ms + tail_ms};
}

}  // namespace

RemainingTime EstimateRemainingTime(std::span<const StageLoad> stages, std::uint32_t worker_count) {
  const auto reference = std::find_if(stages.begin(), stages.end(), [](const StageLoad& stage) { return stage.is_reference; });
  if (reference == stages.end() || reference->done == 0 || worker_count == 0) return {};
  const double whole_ms = reference->sum_ms / reference->done * reference->total / reference->share;
  RemainingTime sum{0.0, 0.0, 0.0};
  for (const StageLoad& stage : stages) {
    const RemainingTime ms = Of(stage, whole_ms * stage.share, worker_count);
    sum.s += ms.s / 1000.0;
    sum.low_s += ms.low_s / 1000.0;
    sum.high_s += ms.high_s / 1000.0;
  }
  return sum;
}

}  // namespace trem
