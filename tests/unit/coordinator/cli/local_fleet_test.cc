// Goal: processes that die are started again within a limit, and none is left. Method: a program folder with shell scripts in the place of
// trem-coordinator and trem-worker that note their starts and then behave well, die, or ignore SIGTERM.
#include "coordinator/cli/local_fleet.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <fstream>
#include <iterator>
#include <thread>

#include "tests/support/paths.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using testing::TempDir;
using testing::WriteFileContents;

class LocalFleetTest : public ::testing::Test {
 protected:
  LocalFleetTest() { fs::create_directories(programs_); }

  // Every script appends its process id to <name>.pids and then runs `body`.
  void WriteProgram(const std::string& name, const std::string& body) {
    const fs::path path = programs_ / name;
    WriteFileContents(path, "#!/bin/sh\necho $$ >> " + (folder_ / (name + ".pids")).string() + "\n" + body + "\n");
    fs::permissions(path, fs::perms::owner_all);
  }
  std::vector<pid_t> StartsOf(const std::string& name) const {
    std::ifstream in(folder_ / (name + ".pids"));
    return {std::istream_iterator<pid_t>(in), std::istream_iterator<pid_t>()};
  }
  template <typename Condition>
  static bool Eventually(const Condition& condition) {
    for (int i = 0; i < 2000; ++i) {
      if (condition()) return true;
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    return false;
  }
  Result<std::unique_ptr<LocalFleet>> StartFleet(int worker_count) {
    return LocalFleet::Start({programs_, folder_ / "work", worker_count});
  }
  static bool IsAlive(pid_t pid) { return ::kill(pid, 0) == 0; }

  TempDir folder_;
  fs::path programs_ = folder_ / "bin";
};

TEST_F(LocalFleetTest, StopsEveryProcessAndRemovesTheSocketFolder) {
  WriteProgram("trem-coordinator", "exec sleep 60");
  WriteProgram("trem-worker", "exec sleep 60");
  auto fleet = StartFleet(2);
  ASSERT_TRUE(fleet.ok()) << fleet.status().ToString();
  const std::string endpoint = (*fleet)->endpoint();
  ASSERT_THAT(endpoint, ::testing::StartsWith("ipc:///"));
  const fs::path socket_folder = fs::path(endpoint.substr(6)).parent_path();
  EXPECT_EQ(fs::status(socket_folder).permissions(), fs::perms::owner_all);
  ASSERT_TRUE(Eventually([&] { return StartsOf("trem-worker").size() == 2 && StartsOf("trem-coordinator").size() == 1; }));
  EXPECT_TRUE((*fleet)->Supervise().ok());
  bool asked = false;
  (*fleet)->Stop([&] { asked = true; }, [] { return false; });
  EXPECT_TRUE(asked);
  for (const char* name : {"trem-worker", "trem-coordinator"}) {
    for (const pid_t pid : StartsOf(name)) EXPECT_FALSE(IsAlive(pid)) << name;
  }
  *fleet = nullptr;
  EXPECT_FALSE(fs::exists(socket_folder));
}

TEST_F(LocalFleetTest, StartsADeadWorkerAgain) {
  WriteProgram("trem-coordinator", "exec sleep 60");
  WriteProgram("trem-worker", "exec sleep 60");
  auto fleet = StartFleet(1);
  ASSERT_TRUE(fleet.ok());
  ASSERT_TRUE(Eventually([&] { return StartsOf("trem-worker").size() == 1; }));
  ::kill(StartsOf("trem-worker")[0], SIGKILL);
  EXPECT_TRUE(Eventually([&] { return (*fleet)->Supervise().ok() && StartsOf("trem-worker").size() == 2; }));
}

TEST_F(LocalFleetTest, GivesUpOnAWorkerThatKeepsDyingAndQuotesItsLog) {
  WriteProgram("trem-coordinator", "exec sleep 60");
  WriteProgram("trem-worker", "echo cannot find my hat; exit 9");
  auto fleet = StartFleet(1);
  ASSERT_TRUE(fleet.ok());
  Status status;
  ASSERT_TRUE(Eventually([&] {
    status = (*fleet)->Supervise();
    return !status.ok();
  }));
  EXPECT_EQ(StartsOf("trem-worker").size(), 4u);  // The first and 3 restarts.
  EXPECT_THAT(status.message(), HasSubstr("worker-1 exited with code 9"));
  EXPECT_THAT(status.message(), HasSubstr("cannot find my hat"));
}

TEST_F(LocalFleetTest, KillsAProcessThatIgnoresSigtermWhenTheUserIsInAHurry) {
  WriteProgram("trem-coordinator", "exec sleep 60");
  WriteProgram("trem-worker", "trap '' TERM\necho ready\nwhile :; do sleep 1; done");
  auto fleet = StartFleet(1);
  ASSERT_TRUE(fleet.ok());
  const fs::path log = folder_.path() / "work" / "logs" / "worker-1.log";
  ASSERT_TRUE(Eventually([&] { return fs::exists(log) && fs::file_size(log) > 0; }));
  (*fleet)->Stop([] {}, [] { return true; });
  EXPECT_FALSE(IsAlive(StartsOf("trem-worker")[0]));
}

TEST_F(LocalFleetTest, SaysWhichProgramIsMissing) {
  WriteProgram("trem-coordinator", "exec sleep 60");
  const auto fleet = StartFleet(1);
  ASSERT_FALSE(fleet.ok());
  EXPECT_THAT(fleet.status().message(), HasSubstr("trem-worker"));
}

TEST(RestartBudget, CountsOnlyTheLastPeriod) {
  RestartBudget budget(2, std::chrono::seconds(60));
  const RestartBudget::Clock::time_point start{};
  EXPECT_TRUE(budget.Take(start));
  EXPECT_TRUE(budget.Take(start + std::chrono::seconds(30)));
  EXPECT_FALSE(budget.Take(start + std::chrono::seconds(59)));
  EXPECT_TRUE(budget.Take(start + std::chrono::seconds(60)));
  EXPECT_FALSE(budget.Take(start + std::chrono::seconds(89)));
  EXPECT_TRUE(budget.Take(start + std::chrono::seconds(90)));
}

}  // namespace
}  // namespace trem
