#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <string>

#include "mosaic/base/status.h"
#include "mosaic/base/version.h"
#include "proto/channel/dealer_channel.h"
#include "worker/app/attempt_log.h"
#include "worker/app/compute_thread.h"

namespace trem {

struct WorkerOptions {
  std::string worker_id;  // Unique per process start.
  std::string host;       // For lists and logs.
  std::uint32_t pid = 0;
  std::string engine_revision = kEngineRevision;
  std::uint64_t memory_bytes_max = 0;  // Told to the coordinator, which sends no task that needs more. 0: no limit.

  AttemptLog* log = nullptr;  // Whose lines are sent to the coordinator as they come. May be null.

  // Given the number of processors that the running task may use from now on: 1 when one begins, others as the coordinator says. Called
  // on the loop's thread. May be empty.
  std::function<void(int processors)> on_share;

  std::chrono::milliseconds log_interval{1000};      // And at the end of an attempt.
  std::chrono::milliseconds hello_interval{1000};    // Until a Welcome.
  std::chrono::milliseconds progress_interval{250};  // Progress is sent at most this often.
  std::chrono::milliseconds done_resend{2000};       // A Done without Ack is sent again after this.
  std::chrono::milliseconds cancel_grace{10000};     // A cancelled task that still runs after this ends the process with exit code 9.
  std::chrono::milliseconds drain_grace{0};          // Told to stop, a running task may go on for this long before it is handed back.
  std::chrono::milliseconds drain_ack_wait{1000};    // How long leaving waits for the Ack of a result.
  std::chrono::milliseconds give_up{0};              // Ends with kUnavailable after such a silence of the coordinator. 0: never.
};

// A worker's side of the control lane, with one compute slot:
//
//   Hello until Welcome -> Dispatch -> Progress ... -> Done until Ack -> the next Dispatch
//
// Says Heartbeat when it has said nothing else for the Welcome's interval. When the coordinator has been silent for three intervals, or
// has restarted, Hello names every attempt that it still holds (running, queued, or done without Ack). A newer attempt of a task that it
// holds replaces the older one; a finished result serves for it, because the same key gives the same bytes.
//
// Runs until `stop` is set (whoever sets it calls channel->Wake()): cancels the task, waits for it, says Goodbye and returns Ok. Other
// ends: kInvalidInput (or the code it gives) when the coordinator refuses this worker, kUnavailable after `give_up`. A task that does not
// stop within `cancel_grace` of being cancelled ends the process by _exit(9): a thread cannot be killed alone.
Status RunWorkerLoop(const WorkerOptions& options, DealerChannel* channel, ComputeThread::Task task, const std::atomic<bool>& stop);

}  // namespace trem
