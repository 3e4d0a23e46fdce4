// Goal: `trem` guides a user who gets the command line wrong. Method: the real program, its exit codes and what it prints.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/e2e/run_fixture.h"

namespace trem::testing {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

Completed Trem(std::vector<std::string> arguments, const SubprocessOptions& options = {}) {
  arguments.insert(arguments.begin(), BinaryPath("trem").string());
  return RunProgram(arguments, std::chrono::seconds(60), options);
}

TEST(CommandLine, ExplainsEveryCommandWithAnExample) {
  for (const char* command :
       {"run", "plan", "inspect", "enhance", "simulate", "submit", "list", "status", "watch", "cancel", "fetch", "workers"}) {
    const Completed help = Trem({command, "--help"});
    EXPECT_EQ(help.exit_code, 0) << command << "\n" << help.stderr_text;
    EXPECT_THAT(help.stdout_text, AllOf(HasSubstr("Example"), HasSubstr(std::string("trem ") + command))) << command;
  }
}

TEST(CommandLine, PrintsItsVersion) {
  const Completed version = Trem({"--version"});
  EXPECT_EQ(version.exit_code, 0);
  EXPECT_THAT(version.stdout_text, ::testing::StartsWith("trem "));
}

TEST(CommandLine, SuggestsTheCommandThatWasMeant) {
  const Completed misspelt = Trem({"inspct", "x"});
  EXPECT_EQ(misspelt.exit_code, 2);
  EXPECT_THAT(misspelt.stderr_text, HasSubstr("did you mean 'inspect'?"));
}

TEST(CommandLine, SuggestsTheOptionThatWasMeant) {
  const Completed misspelt = Trem({"run", "x", "-o", "y.tif", "--workes=2"});
  EXPECT_EQ(misspelt.exit_code, 2);
  EXPECT_THAT(misspelt.stderr_text, HasSubstr("did you mean '--workers'?"));
}

TEST(CommandLine, NamesWhatIsMissing) {
  const Completed missing = Trem({"run", "x"});
  EXPECT_EQ(missing.exit_code, 2);
  EXPECT_THAT(missing.stderr_text, HasSubstr("--output"));
}

TEST(CommandLine, SaysThatNoCoordinatorAnswers) {
  const TempDir folder;
  const std::string endpoint = "ipc://" + (folder / "nobody").string();
  const SubprocessOptions options = {{"TREM_COORDINATOR=" + endpoint}, {}, false};
  for (const std::vector<std::string>& arguments : {std::vector<std::string>{"list"}, {"watch", "job-1"}}) {
    const Completed command = Trem(arguments, options);
    EXPECT_EQ(command.exit_code, 4) << arguments[0];
    EXPECT_EQ(Lines(command.stderr_text).size(), 1u) << command.stderr_text;
    EXPECT_THAT(command.stderr_text, AllOf(HasSubstr("no coordinator answers"), HasSubstr(endpoint)));
  }
}

}  // namespace
}  // namespace trem::testing
