// Goal: the helpers that every process test stands on report what really happened. Method: small shell programs with known output,
// exit codes, signals and descendants.
#include "tests/support/subprocess.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include "tests/support/paths.h"

namespace trem::testing {
namespace {

using std::chrono::seconds;

TEST(Subprocess, CapturesOutputAndExitCode) {
  const Completed completed =
      RunProgram({"sh", "-c", "echo out; echo err >&2; echo $EXTRA; pwd; exit 7"}, seconds(20), {{"EXTRA=more"}, "/"});
  EXPECT_TRUE(completed.ended);
  EXPECT_EQ(completed.exit_code, 7);
  EXPECT_EQ(completed.stdout_text, "out\nmore\n/\n");
  EXPECT_EQ(completed.stderr_text, "err\n");
  EXPECT_TRUE(completed.orphans.empty());
}

TEST(Subprocess, ReportsTheSignalThatEndedTheChild) {
  Subprocess process({"sleep", "60"});
  EXPECT_FALSE(process.Wait(std::chrono::milliseconds(20)).has_value());
  process.Signal(SIGTERM);
  const auto exit = process.Wait(seconds(20));
  ASSERT_TRUE(exit.has_value());
  EXPECT_EQ(exit->signal, SIGTERM);
  EXPECT_EQ(exit->code, 128 + SIGTERM);
}

TEST(Subprocess, SeesADescendantThatOutlivesTheChild) {
  Subprocess process({"sh", "-c", "sleep 61 & exit 0"});
  ASSERT_TRUE(process.Wait(seconds(20)).has_value());
  const std::vector<pid_t> left = process.Descendants();
  ASSERT_EQ(left.size(), 1u);
  EXPECT_THAT(CommandLine(left[0]), ::testing::HasSubstr("sleep"));
  ::kill(left[0], SIGKILL);
  EXPECT_TRUE(process.DescendantsAfter(seconds(20)).empty());
}

TEST(Subprocess, SaysWhyAProgramCannotBeStarted) {
  const Completed completed = RunProgram({"/no/such/program"}, seconds(20));
  EXPECT_EQ(completed.exit_code, 127);
  EXPECT_THAT(completed.stderr_text, ::testing::HasSubstr("No such file"));
}

TEST(TempDir, IsRemovedWithItsContents) {
  std::filesystem::path path;
  {
    TempDir folder;
    path = folder.path();
    WriteFileContents(folder / "file", "text");
    EXPECT_EQ(FileContents(folder / "file"), "text");
  }
  EXPECT_FALSE(std::filesystem::exists(path));
}

}  // namespace
}  // namespace trem::testing
