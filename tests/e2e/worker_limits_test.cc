// Goal: what native code does to itself ends a task, not the worker: a crash, a hang, a task that takes too long; and the memory limit is
// the compute process'. Method: the real programs; the test crashes or stops the compute process in the middle of a task. That allocations
// beyond the limit fail and are reported is compute_process_test's.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <nlohmann/json.hpp>
#include <thread>

#include "tests/e2e/run_fixture.h"

namespace trem::testing {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class WorkerLimitsTest : public ::testing::Test {
 protected:
  void SetUp() override {
    for (int i = 0; i < 3000 && !fs::exists(ready_); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
    ASSERT_TRUE(fs::exists(ready_)) << coordinator_.Stderr();
    endpoint_ = Lines(FileContents(ready_)).at(0);
    const fs::path sortie = fixture_.SimulateSortie("sortie", 16);
    ASSERT_EQ(Trem({"submit", (sortie / "sortie.textproto").string(), "--job-id", "town"}).exit_code, 0);
  }
  Completed Trem(std::vector<std::string> arguments) const {
    arguments.insert(arguments.begin(), BinaryPath("trem").string());
    SubprocessOptions options = fixture_.Options();
    options.environment.push_back("TREM_COORDINATOR=" + endpoint_);
    return RunProgram(arguments, std::chrono::minutes(10), options);
  }
  void StartWorker(const std::vector<std::string>& more) {
    std::vector<std::string> argv = {BinaryPath("trem-worker").string(), "serve", "--coordinator", endpoint_, "--store", store_.string()};
    argv.insert(argv.end(), more.begin(), more.end());
    worker_ = std::make_unique<Subprocess>(argv, fixture_.Options());
  }
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

  RunFixture fixture_;
  fs::path ready_ = fixture_.folder() / "ready";
  fs::path store_ = fixture_.folder() / "store";
  Subprocess coordinator_{{BinaryPath("trem-coordinator").string(), "--state", (fixture_.folder() / "state").string(), "--store",
                           store_.string(), "--bind", "tcp://127.0.0.1:*", "--ready-file", ready_.string()},
                          fixture_.Options()};
  std::string endpoint_;
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
