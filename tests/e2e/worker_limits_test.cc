// Goal: what native code does to itself ends a task, not the worker: a crash, a hang, a task that takes too long; and the memory limit is
// the compute process'. Method: the real programs; the test crashes or stops the compute process in the middle of a task. That allocations
// beyond the limit fail and are reported is compute_process_test's.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <nlohmann/json.hpp>
#include <thread>

#include "tests/e2e/service_fixture.h"

namespace trem::testing {
namespace {

using ::testing::HasSubstr;

class WorkerLimitsTest : public ServiceTest {
 protected:
  void SetUp() override {
    Start();
    Submit("town", 16);
  }
  void StartWorker(const std::vector<std::string>& more) { worker_ = Worker(more); }
  // The worker's compute process, once it has been given a task.
  pid_t ComputeProcess() const {
    for (int i = 0; i < 6000; ++i) {
      const auto workers = nlohmann::json::parse(Trem({"workers", "--json"}).stdout_text);
      if (workers.size() == 1 && !workers[0]["running"].empty()) {
        for (const pid_t pid : worker_->Descendants()) {
          if (CommandLine(pid).find("compute") != std::string::npos) return pid;
        }
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    ADD_FAILURE() << "no task was begun";
    return -1;
  }
  // The job is done by the worker that began it, and its log says what happened to the task.
  void ExpectDoneBySameWorker(const std::string& what_happened) {
    const Completed watch = Trem({"watch", "town"});
    EXPECT_EQ(watch.exit_code, 0) << watch.stderr_text;
    EXPECT_THAT(Trem({"logs", "town"}).stdout_text, HasSubstr(what_happened));
    EXPECT_FALSE(worker_->Wait(std::chrono::milliseconds(0)).has_value()) << worker_->Stderr();
    EXPECT_EQ(nlohmann::json::parse(Trem({"workers", "--json"}).stdout_text).size(), 1U);
  }

  std::unique_ptr<Subprocess> worker_;
};

TEST_F(WorkerLimitsTest, ACrashCostsTheTask) {
  StartWorker({});
  const pid_t compute = ComputeProcess();
  // Stopped, whatever it was given last stays in it.
  ::kill(compute, SIGSTOP);
  std::this_thread::sleep_for(std::chrono::seconds(1));
  ::kill(compute, SIGSEGV);
  ::kill(compute, SIGCONT);
  ExpectDoneBySameWorker("ended by signal 11");
}

TEST_F(WorkerLimitsTest, AHangIsNoticedAndCostsTheTask) {
  StartWorker({"--silence-max-s", "10"});
  ::kill(ComputeProcess(), SIGSTOP);
  ExpectDoneBySameWorker("made no progress");
}

// Before the coordinator would take the task back (20 s without progress).
TEST_F(WorkerLimitsTest, ADeadlineCostsTheTask) {
  StartWorker({"--task-max-s", "12"});
  ::kill(ComputeProcess(), SIGSTOP);
  ExpectDoneBySameWorker("took more than");
}

TEST_F(WorkerLimitsTest, TheMemoryLimitIsTheComputeProcess) {
  constexpr const char* kLimit = "3000000000";
  StartWorker({"--memory-max-bytes", kLimit});
  const pid_t compute = ComputeProcess();
  const auto data_limit = [](pid_t pid) {
    for (const std::string& line : Lines(FileContents("/proc/" + std::to_string(pid) + "/limits"))) {
      if (line.starts_with("Max data size")) return line;
    }
    return std::string("gone");
  };
  // It sets the limit itself, a moment after it was started.
  for (int i = 0; i < 2000 && data_limit(compute).find(kLimit) == std::string::npos; ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  EXPECT_THAT(data_limit(compute), HasSubstr(kLimit));
  EXPECT_THAT(data_limit(worker_->pid()), HasSubstr("unlimited"));
  EXPECT_EQ(Trem({"watch", "town"}).exit_code, 0);
}

}  // namespace
}  // namespace trem::testing
