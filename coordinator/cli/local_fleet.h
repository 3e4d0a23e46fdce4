#pragma once

#include <sys/types.h>

#include <chrono>
#include <deque>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "mosaic/base/status.h"

namespace trem {

// Limits how often something may be started again: at most `count_max` times in any `period`.
class RestartBudget {
 public:
  using Clock = std::chrono::steady_clock;
  RestartBudget(int count_max, Clock::duration period) : count_max_(count_max), period_(period) {}
  // True, and counted, when a restart at `now` is within the limit.
  bool Take(Clock::time_point now);

 private:
  int count_max_;
  Clock::duration period_;
  std::deque<Clock::time_point> taken_;
};

struct LocalFleetOptions {
  std::filesystem::path program_folder;  // Holds trem-coordinator and trem-worker.
  std::filesystem::path work_folder;     // Gets state/, store/ and logs/.
  int worker_count = 1;
};

// A coordinator and workers on this machine, as child processes. They talk through a socket in a private folder under $XDG_RUNTIME_DIR or
// /tmp, since socket paths are limited to 107 bytes. None of them outlives this process.
class LocalFleet {
 public:
  static Result<std::unique_ptr<LocalFleet>> Start(const LocalFleetOptions& options);
  // Kills what Stop has not stopped and removes the socket's folder.
  ~LocalFleet();
  LocalFleet(const LocalFleet&) = delete;
  LocalFleet& operator=(const LocalFleet&) = delete;

  const std::string& endpoint() const { return endpoint_; }
  // Starts processes that ended again, at most 3 times a minute each. Beyond that: an error that quotes the process' last log lines.
  Status Supervise();
  // Ends all processes in order: SIGTERM to the workers, then `ask_coordinator` (which sends Shutdown), then SIGTERM to the coordinator;
  // SIGKILL for any that takes longer than 5 s, and at once when `in_a_hurry` says so.
  void Stop(const std::function<void()>& ask_coordinator, const std::function<bool()>& in_a_hurry);

 private:
  struct Slot {
    std::string name;
    std::vector<std::string> argv;
    std::filesystem::path log_path;
    RestartBudget budget;
    pid_t pid = -1;
  };

  explicit LocalFleet(const LocalFleetOptions& options) : options_(options) {}
  Status MakeSocketFolder();
  void AddSlot(const std::string& name, std::vector<std::string> argv);
  Status GiveUp(const Slot& slot, int wait_status) const;
  // Waits until the slots have ended; kills them when it takes too long.
  void AwaitEnd(const std::vector<Slot*>& slots, std::chrono::milliseconds patience, const std::function<bool()>& in_a_hurry);

  LocalFleetOptions options_;
  std::filesystem::path socket_folder_;
  std::string endpoint_;
  std::vector<Slot> slots_;  // The coordinator first.
};

}  // namespace trem
