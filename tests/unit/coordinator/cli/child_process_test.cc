// Goal: children start with their output in the log and a group of their own, and their ends are told apart. Method: /bin/sh programs.
#include "coordinator/cli/child_process.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tests/support/paths.h"

namespace trem {
namespace {

using testing::FileContents;
using ::testing::HasSubstr;
using testing::TempDir;
using testing::WriteFileContents;

TEST(StartChild, AppendsBothOutputsToTheLogAndReadsNothing) {
  TempDir folder;
  WriteFileContents(folder / "log", "before\n");
  const auto pid = StartChild({"/bin/sh", "-c", "echo out; echo err >&2; cat"}, folder / "log");
  ASSERT_TRUE(pid.ok()) << pid.status().ToString();
  int wait_status = 0;
  ASSERT_EQ(::waitpid(*pid, &wait_status, 0), *pid);
  EXPECT_EQ(DescribeExit(wait_status), "exited with code 0");
  EXPECT_EQ(FileContents(folder / "log"), "before\nout\nerr\n");
}

TEST(StartChild, GivesTheChildItsOwnGroupAndItsDeathIsSeen) {
  TempDir folder;
  const auto pid = StartChild({"/bin/sleep", "60"}, folder / "log");
  ASSERT_TRUE(pid.ok());
  EXPECT_EQ(::getpgid(*pid), *pid);
  EXPECT_FALSE(ReapChild(*pid).has_value());
  ::kill(*pid, SIGKILL);
  int wait_status = 0;
  ASSERT_EQ(::waitpid(*pid, &wait_status, 0), *pid);
  EXPECT_THAT(DescribeExit(wait_status), HasSubstr("signal 9"));
}

TEST(StartChild, NamesAProgramThatIsMissing) {
  TempDir folder;
  const auto pid = StartChild({"/no/such/trem-worker"}, folder / "log");
  ASSERT_FALSE(pid.ok());
  EXPECT_THAT(pid.status().message(), HasSubstr("/no/such/trem-worker"));
}

TEST(LastLines, ReturnsTheEndOfALongFile) {
  TempDir folder;
  std::string text;
  for (int i = 0; i < 10000; ++i) text += "line " + std::to_string(i) + "\n";
  WriteFileContents(folder / "log", text);
  EXPECT_EQ(LastLines(folder / "log", 2), "line 9998\nline 9999");
  EXPECT_EQ(LastLines(folder / "none", 2), "");
}

}  // namespace
}  // namespace trem
