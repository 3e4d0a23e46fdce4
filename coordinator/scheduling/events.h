#pragma once

#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include "mosaic/base/status.h"
#include "proto/trem/v1/events.pb.h"
#include "proto/trem/v1/job.pb.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// Milliseconds of a clock that never goes backwards; only differences mean anything.
using TimeMs = std::int64_t;

// One numbered hand-out of a task.
struct Attempt {
  std::string task_key;
  std::uint32_t number = 0;
  friend auto operator<=>(const Attempt&, const Attempt&) = default;
};

// ---- What happens to the scheduler ----------------------------------------------------------------------------------------------

// Preconditions: `job_id` passes IsJobId; `sortie` is complete and, when the job exists, equal to the job's. A job that runs or is done,
// wholly or in part, is left alone; one that failed or was cancelled is taken up again, and finished tasks are reused.
struct SubmitJobEvent {
  std::string job_id;
  v1::Sortie sortie;
  std::string user;  // Whose share of the workers it uses.
  int priority = 0;  // A higher one goes first.
};
// Takes up what failed of a job that has failed, was cancelled or ended in part; nothing for others.
struct RetryJobEvent {
  std::string job_id;
};
struct CancelJobEvent {
  std::string job_id;
};
// Forgets a job that has ended, and every result that no other job has used; nothing for one that runs. A later job that wants such a
// result has it computed again.
struct RemoveJobEvent {
  std::string job_id;
};
// A worker's first message, and again after every reconnect. `running` is everything it computes or keeps a result of.
struct WorkerHelloEvent {
  std::string worker_id;
  std::string host;
  std::uint32_t pid = 0;
  std::uint32_t credit = 1;
  std::uint64_t memory_bytes_max = 0;  // 0: no limit.
  std::vector<Attempt> running;
};
// The worker has not been heard of for too long.
struct WorkerLostEvent {
  std::string worker_id;
};
// The worker leaves and hands everything back.
struct WorkerGoodbyeEvent {
  std::string worker_id;
};
// The worker is to get nothing more and to leave when it is done with what it has.
struct DrainWorkerEvent {
  std::string worker_id;
};
struct ProgressEvent {
  std::string worker_id;
  Attempt attempt;
  double fraction = 0.0;
};
struct TaskDoneEvent {
  std::string worker_id;
  Attempt attempt;
  StatusCode code = StatusCode::kOk;
  std::string message;    // When code is not kOk.
  v1::TaskResult result;  // When code is kOk.
  std::uint64_t elapsed_ms = 0;
  std::uint64_t peak_memory_bytes = 0;
  std::vector<std::string> bad_artefacts;  // Digests of inputs that are damaged or missing, when that is why it failed.
};
// Time has passed. Leases end only here, so a shell that was itself stopped for a while can deliver the Progress that waited first.
struct TickEvent {};

using Event = std::variant<SubmitJobEvent, RetryJobEvent, CancelJobEvent, RemoveJobEvent, WorkerHelloEvent, WorkerLostEvent,
                           WorkerGoodbyeEvent, DrainWorkerEvent, ProgressEvent, TaskDoneEvent, TickEvent>;

// ---- What the shell has to do about it ------------------------------------------------------------------------------------------

// Make durable. Nothing that stands behind it, in this list or a later one, may leave before it is.
struct AppendEffect {
  v1::LogEvent event;
};
struct DispatchEffect {
  std::string worker_id;
  v1::TaskSpec task;
  std::uint32_t attempt = 0;
  std::uint32_t lease_ms = 0;
};
struct AckEffect {
  std::string worker_id;
  Attempt attempt;
};
struct CancelTaskEffect {
  std::string worker_id;
  Attempt attempt;
  std::string reason;
};
// How many processors the attempt may use from now on. Until it is told, and after each Hello, a worker uses one.
struct ShareEffect {
  std::string worker_id;
  Attempt attempt;
  std::uint32_t processors = 1;
};
struct DrainWorkerEffect {
  std::string worker_id;
};
// The job's state (not merely its progress) changed.
struct JobChangedEffect {
  std::string job_id;
};
// For the log of the program, and of the jobs that share the task.
struct LogEffect {
  std::string text;
  std::string task_key;
};

using Effect =
    std::variant<AppendEffect, DispatchEffect, AckEffect, CancelTaskEffect, ShareEffect, DrainWorkerEffect, JobChangedEffect, LogEffect>;

}  // namespace trem
