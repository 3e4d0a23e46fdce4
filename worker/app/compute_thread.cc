#include "worker/app/compute_thread.h"

#include <utility>

namespace trem {

ComputeThread::ComputeThread(Task task, std::function<void()> on_finished) : task_(std::move(task)), on_finished_(std::move(on_finished)) {}

ComputeThread::~ComputeThread() {
  Cancel();
  {
    const std::lock_guard lock(mutex_);
    is_leaving_ = true;
  }
  has_news_.notify_one();
  if (thread_.joinable()) thread_.join();
}

void ComputeThread::Start(v1::TaskSpec spec) {
  TREM_CHECK(!is_running_);
  is_running_ = true;
  spec_ = std::move(spec);
  has_ended_ = false;
  cancelled_ = false;
  fraction_ = 0.0;
  taken_report_count_ = report_count_;
  {
    const std::lock_guard lock(mutex_);
    has_task_ = true;
  }
  has_news_.notify_one();
  if (!thread_.joinable()) thread_ = std::thread([this] { Serve(); });
}

void ComputeThread::Serve() {
  for (;;) {
    {
      std::unique_lock lock(mutex_);
      has_news_.wait(lock, [this] { return has_task_ || is_leaving_; });
      if (!has_task_) return;
      has_task_ = false;
    }
    const auto start = std::chrono::steady_clock::now();
    TaskOutcome outcome = task_(spec_, [this](double fraction) { return Report(fraction); });
    finished_.emplace(
        Finished{std::move(outcome), std::chrono::duration_cast<std::chrono::milliseconds>(std::chrono::steady_clock::now() - start)});
    has_ended_ = true;
    on_finished_();
  }
}

bool ComputeThread::Report(double fraction) {
  if (fraction < 0.0) return !cancelled_;                                 // Just a question.
  fraction_ = fraction <= 1.0 ? fraction : (fraction > 1.0 ? 1.0 : 0.0);  // NaN becomes 0.
  ++report_count_;
  return !cancelled_;
}

std::optional<double> ComputeThread::TakeProgress() {
  const std::uint64_t count = report_count_;
  if (count == taken_report_count_) return std::nullopt;
  taken_report_count_ = count;
  return fraction_.load();
}

std::optional<ComputeThread::Finished> ComputeThread::TakeFinished() {
  if (!is_running_ || !has_ended_) return std::nullopt;
  is_running_ = false;
  return std::exchange(finished_, std::nullopt);
}

}  // namespace trem
