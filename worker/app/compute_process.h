#pragma once

#include <sys/types.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "mosaic/base/status.h"
#include "proto/channel/wake_event.h"
#include "worker/app/compute_protocol.h"

namespace trem {

struct ComputeProcessOptions {
  // The program and its arguments; the socket's number is appended as "--fd N".
  std::vector<std::string> argv;
  // Given what the child writes to stderr while it computes, as it comes; it goes to this process' stderr too. Empty: only there.
  std::function<void(std::string_view bytes)> on_stderr;
  // A task that reports no progress for this long is taken for hung: its process is killed.
  std::chrono::milliseconds silence_max{300'000};
  // A task may take this long at most. 0: no limit.
  std::chrono::milliseconds task_max{0};
  // A cancelled task that still runs after this is killed with its process.
  std::chrono::milliseconds cancel_grace{5'000};
};

// Computes in a child process, so that what a crash, an out-of-memory kill or a hang in native code ends is the task, not the worker. The
// child is started with the first task, or before by Start, and again after it has died; between tasks it sleeps. Calls belong to one
// thread at a time, where nothing else is said.
class ComputeProcess {
 public:
  explicit ComputeProcess(ComputeProcessOptions options) : options_(std::move(options)) {}
  // Kills the child.
  ~ComputeProcess();
  ComputeProcess(const ComputeProcess&) = delete;
  ComputeProcess& operator=(const ComputeProcess&) = delete;

  // Starts the child, so that the first task need not wait until a few hundred libraries are loaded. Where that fails, Run says so.
  void Start() { (void)EnsureStarted(); }

  // How many processors the task may use from now on, until another one begins with one. From any thread.
  void SetProcessors(int processors);

  // See TaskFunction. When the child dies: kExhausted after SIGKILL, which is how the kernel ends what takes too much memory; kFailed with
  // the signal's name otherwise.
  TaskOutcome Run(const v1::TaskSpec& spec, const std::function<bool(double)>& progress);

 private:
  Status EnsureStarted();
  TaskOutcome Await(const v1::TaskSpec& spec, const std::function<bool(double)>& progress);
  // Ends the child, waits for it and says how it died.
  int Reap(bool kill);
  void RelayStderr();
  TaskOutcome Death(const v1::TaskSpec& spec);

  ComputeProcessOptions options_;
  std::atomic<int> processors_{1};
  WakeEvent wake_;  // When that has changed.
  pid_t pid_ = -1;
  int fd_ = -1;
  int stderr_fd_ = -1;  // Where it can be read; negative: the child has this process' own.
  ComputeFrameReader reader_;
};

}  // namespace trem
