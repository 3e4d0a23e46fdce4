#pragma once

#include <cstdint>
#include <span>

namespace trem {

// What is known of a stage of a job.
struct StageLoad {
  double share = 0.0;             // Guessed part of the job's whole work, of the stage by which the others are judged: `reference`.
  bool is_reference = false;      // The stage whose done tasks give the scale of those that have done none yet.
  std::uint32_t total = 0;        // Tasks; 0: not known yet.
  std::uint32_t done = 0;         // Of these, those that gave a result,
  std::uint32_t given_up = 0;     // and those that never will.
  double running_fraction = 0.0;  // Sum over the running ones.
  double sum_ms = 0.0;            // Of the durations of the done ones,
  double sum_ms2 = 0.0;           // and of their squares.
};

// Seconds; negative: not known.
struct RemainingTime {
  double s = -1.0;
  double low_s = -1.0;
  double high_s = -1.0;
};

// How long the stages, one after the other, will still take `worker_count` workers. Unknown until the reference stage has done a task.
//
//   s = sum over stages of left * mean / w,   w = min(workers, tasks left)
//
// [low_s, high_s] holds the truth with a probability of about 80 %: a sum of `left` durations with the spread s.d. of those seen (their
// mean, while there is one) and with the error of their mean, 1.28 * s.d. * sqrt(left + left^2 / done) / w to either side; up to one more
// mean duration above, when the last tasks do not end together; half to twice the guess for a stage that has done nothing yet.
RemainingTime EstimateRemainingTime(std::span<const StageLoad> stages, std::uint32_t worker_count);

}  // namespace trem
