#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <mutex>
#include <optional>
#include <thread>

#include "mosaic/base/status.h"
#include "proto/trem/v1/task.pb.h"
#include "worker/app/compute_protocol.h"

namespace trem {

// Runs one task at a time on a thread of its own, so that the thread that owns the socket always answers. All calls belong to one thread,
// the owner's.
class ComputeThread {
 public:
  using Task = TaskFunction;
  struct Finished {
    TaskOutcome outcome;
    std::chrono::milliseconds elapsed{0};
  };

  // `on_finished` is called on the compute thread when a task has ended.
  ComputeThread(Task task, std::function<void()> on_finished);
  // Cancels and waits for a task that still runs.
  ~ComputeThread();
  ComputeThread(const ComputeThread&) = delete;
  ComputeThread& operator=(const ComputeThread&) = delete;

  // Precondition: nothing runs (TakeFinished has returned the last result).
  void Start(v1::TaskSpec spec);
  // Makes `progress` return false from now on.
  void Cancel() { cancelled_ = true; }
  // The newest fraction, when the task reported any since the last call. A task that hangs reports nothing, and its lease ends.
  std::optional<double> TakeProgress();
  // The result, once, when the task has ended.
  std::optional<Finished> TakeFinished();

 private:
  bool Report(double fraction);
  // The thread's: task after task, until the owner leaves.
  void Serve();

  Task task_;
  std::function<void()> on_finished_;
  std::thread thread_;  // Started with the first task; sleeps between tasks.
  std::mutex mutex_;
  std::condition_variable has_news_;
  bool has_task_ = false;  // Guarded by mutex_, as is the next: for the thread.
  bool is_leaving_ = false;
  bool is_running_ = false;  // The owner's: from Start until the result was taken.
  v1::TaskSpec spec_;
  std::optional<Finished> finished_;  // Written by the compute thread before has_ended_ is set, read after.
  std::atomic<bool> has_ended_{false};
  std::atomic<bool> cancelled_{false};
  std::atomic<double> fraction_{0.0};
  std::atomic<std::uint64_t> report_count_{0};
  std::uint64_t taken_report_count_ = 0;
};

}  // namespace trem
