#pragma once

#include <cstdint>

namespace trem {

struct SchedulerOptions {
  // A lease ends this long after the dispatch or the last Progress. Shorter: a hung task is noticed sooner, but a task that reports
  // seldom loses its lease while it works.
  std::uint32_t lease_ms = 20'000;
  // A task that reports kFailed, kCorrupt or kNotFound this often, on two workers when there are two, is given up; twice as often on
  // whichever.
  std::uint32_t failures_max = 3;
  // The same for kUnavailable and kExhausted: a mount, a peer or a disk comes back, and it is not the task's fault. With the delays below a
  // full disk may last 5 minutes.
  std::uint32_t outages_max = 8;
  // A task whose lease was lost this often (worker gone, hung, or message lost) is given up: it may be what kills the workers.
  std::uint32_t losses_max = 10;
  // How often the result of one task may be found damaged in the store and made again.
  std::uint32_t repairs_max = 5;
  // Before the second attempt after a failure; doubles with every further one, up to retry_delay_ms_max.
  std::uint32_t retry_delay_ms = 1'000;
  // The same after kExhausted: room takes longer to appear.
  std::uint32_t exhausted_delay_ms = 5'000;
  std::uint32_t retry_delay_ms_max = 60'000;
  // A task that runs alone for longer than this, and than so many times its stage's mean, gets a second attempt beside it when a worker is
  // idle and nothing else is ready. A factor of 0 turns that off.
  std::uint32_t hedge_after_ms = 5'000;
  double hedge_factor = 2.0;
  // Tasks that one user may have running at once while others wait. 0: no limit.
  std::uint32_t user_tasks_max = 0;
  // After a restart, how long a task that was handed out before waits for its worker to come back and name it.
  std::uint32_t restart_grace_ms = 3'000;
};

}  // namespace trem
