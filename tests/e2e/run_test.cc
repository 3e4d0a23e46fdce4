// Goal: `trem run` gives the same bytes whatever happens to its processes, and leaves nothing behind. Method: real processes on a small
// simulated sortie, with 1, 2 and 3 workers, with SIGKILL for a worker, the coordinator and trem itself, a worker that hangs, and Ctrl-C;
// all published files are compared byte by byte with those of an undisturbed run.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <nlohmann/json.hpp>
#include <thread>

#include "tests/e2e/run_fixture.h"

namespace trem::testing {
namespace {

namespace fs = std::filesystem;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

constexpr std::chrono::minutes kPatience{8};
constexpr int kFrameCount = 48;
// The manifest and the first results of Enhance tasks are stored; many tasks are still to come.
constexpr int kObjectsInTheMiddle = 6;

class RunTest : public ::testing::Test {
 protected:
  fs::path WorkOf(const fs::path& folder) const { return folder / "town.tif.work"; }

  // An undisturbed run into a new folder; returns what it published.
  std::map<std::string, std::string> CleanRun(const std::string& name, int worker_count) {
    const fs::path out = fixture_.NewFolder(name);
    const Completed run =
        fixture_.Run(RunFixture::RunArguments(sortie_, out / "town.tif", {"--workers", std::to_string(worker_count), "--quiet"}));
    EXPECT_EQ(run.exit_code, 0) << run.stderr_text;
    EXPECT_THAT(run.orphans, IsEmpty());
    EXPECT_FALSE(fs::exists(WorkOf(out)));
    EXPECT_TRUE(fixture_.RuntimeFolderIsEmpty());
    return FilesIn(out);
  }

  // Waits until the run is in the middle. False when it ended before.
  static bool AwaitMiddle(Subprocess* run, const fs::path& work) {
    for (int i = 0; i < 60000; ++i) {
      if (StoredObjectCount(work) >= kObjectsInTheMiddle) return true;
      if (run->Wait(std::chrono::milliseconds(10))) return false;
    }
    return false;
  }

  static std::vector<pid_t> ProcessesOf(const Subprocess& run, const std::string& program) {
    std::vector<pid_t> found;
    for (const pid_t pid : run.Descendants()) {
      if (CommandLine(pid).find(program + " ") != std::string::npos) found.push_back(pid);
    }
    return found;
  }

  // Runs with two workers, sends `signal_number` to one process of `program` in the middle and expects the bytes of an undisturbed run.
  void ExpectSurvives(int signal_number, const std::string& program) {
    const auto expected = CleanRun("reference", 2);
    ASSERT_THAT(expected, Contains(::testing::Key("town.tif")));
    const fs::path out = fixture_.NewFolder("disturbed");
    Subprocess run(RunFixture::RunArguments(sortie_, out / "town.tif", {"--workers", "2"}), fixture_.Options());
    ASSERT_TRUE(AwaitMiddle(&run, WorkOf(out))) << run.Stderr();
    const std::vector<pid_t> pids = ProcessesOf(run, program);
    ASSERT_FALSE(pids.empty()) << program;
    ASSERT_FALSE(fs::exists(out / "town.tif"));
    ASSERT_EQ(::kill(pids[0], signal_number), 0);
    const auto exit = run.Wait(kPatience);
    ASSERT_TRUE(exit.has_value());
    EXPECT_EQ(exit->code, 0) << run.Stderr();
    EXPECT_THAT(run.DescendantsAfter(std::chrono::seconds(2)), IsEmpty());
    EXPECT_TRUE(FilesIn(out) == expected) << "the published files differ";
    EXPECT_TRUE(fixture_.RuntimeFolderIsEmpty());
  }

  // Ends a run in the middle with a signal to trem's own process group, as a terminal does, and resumes it with the same command.
  void ExpectResumesAfter(int signal_number, int exit_code) {
    const auto expected = CleanRun("reference", 2);
    ASSERT_THAT(expected, Contains(::testing::Key("town.tif")));
    const fs::path out = fixture_.NewFolder("interrupted");
    const auto argv = RunFixture::RunArguments(sortie_, out / "town.tif", {"--workers", "2", "--quiet"});
    {
      Subprocess run(argv, fixture_.Options());
      ASSERT_TRUE(AwaitMiddle(&run, WorkOf(out))) << run.Stderr();
      ASSERT_EQ(::kill(-run.pid(), signal_number), 0);
      const auto exit = run.Wait(kPatience);
      ASSERT_TRUE(exit.has_value());
      EXPECT_EQ(exit->code, exit_code) << run.Stderr();
      EXPECT_THAT(run.DescendantsAfter(std::chrono::seconds(10)), IsEmpty());
      EXPECT_EQ(NamesIn(out), std::vector<std::string>{"town.tif.work"}) << "something appeared at the output's place";
      if (signal_number != SIGKILL) {
        ASSERT_EQ(Lines(run.Stderr()).size(), 1u) << run.Stderr();
        EXPECT_THAT(run.Stderr(), HasSubstr("the same command resumes"));
        EXPECT_TRUE(fixture_.RuntimeFolderIsEmpty());
      }
    }
    const Completed resumed = fixture_.Run(argv);
    EXPECT_EQ(resumed.exit_code, 0) << resumed.stderr_text;
    EXPECT_TRUE(FilesIn(out) == expected) << "the published files differ";
    EXPECT_FALSE(fs::exists(WorkOf(out)));
    EXPECT_TRUE(fixture_.RuntimeFolderIsEmpty());
  }

  RunFixture fixture_;
  fs::path sortie_ = fixture_.SimulateSortie("sortie", kFrameCount) / "sortie.textproto";
};

TEST_F(RunTest, GivesTheSameBytesForOneTwoAndThreeWorkers) {
  const auto one = CleanRun("one", 1);
  EXPECT_THAT(one, Contains(::testing::Key("town.tif")));
  EXPECT_THAT(one, Contains(::testing::Key("town_quality.tif")));
  EXPECT_THAT(one, Contains(::testing::Key("town_chain.csv")));
  EXPECT_THAT(one, Contains(::testing::Key("town_windows.geojson")));
  EXPECT_THAT(one, Contains(::testing::Key("town_preview.png")));
  EXPECT_TRUE(CleanRun("two", 2) == one) << "2 workers gave other files than 1";
  EXPECT_TRUE(CleanRun("three", 3) == one) << "3 workers gave other files than 1";
}

// Whoever talks to a standing service has its keys in the environment; the coordinator of a run on this machine asks for none.
TEST_F(RunTest, HeedsNoKeysOfAnotherCoordinator) {
  const fs::path output = fixture_.NewFolder("out") / "mosaic.tif";
  SubprocessOptions options = fixture_.Options();
  for (const char* name : {"TREM_KEY", "TREM_COORDINATOR_KEY"}) options.environment.push_back(std::string(name) + "=/nowhere/ann.key");
  const Completed run = RunProgram(RunFixture::RunArguments(sortie_, output), std::chrono::minutes(2), options);
  EXPECT_EQ(run.exit_code, 0) << run.stderr_text;
}

TEST_F(RunTest, GivesTheSameBytesWhenAWorkerIsKilled) { ExpectSurvives(SIGKILL, "trem-worker"); }

// A stopped process neither answers nor closes its connection, as one that hangs.
TEST_F(RunTest, GivesTheSameBytesWhenAWorkerHangs) { ExpectSurvives(SIGSTOP, "trem-worker"); }

TEST_F(RunTest, GivesTheSameBytesWhenTheCoordinatorIsKilled) { ExpectSurvives(SIGKILL, "trem-coordinator"); }

TEST_F(RunTest, StopsOnCtrlCAndResumesToTheSameBytes) { ExpectResumesAfter(SIGINT, 130); }

TEST_F(RunTest, LeavesNoProcessWhenKilledAndResumesToTheSameBytes) { ExpectResumesAfter(SIGKILL, 128 + SIGKILL); }

TEST_F(RunTest, ReportsTheResultAsJson) {
  const fs::path out = fixture_.NewFolder("out");
  const Completed run = fixture_.Run(RunFixture::RunArguments(sortie_, out / "town.tif", {"--workers", "2", "--json", "--keep-work"}));
  ASSERT_EQ(run.exit_code, 0) << run.stderr_text;
  const auto json = nlohmann::json::parse(run.stdout_text);
  EXPECT_EQ(json["state"], "done");
  EXPECT_EQ(json["exit_code"], 0);
  EXPECT_GT(json["peak_memory_bytes"].get<double>(), 0.0);
  EXPECT_LT(json["peak_memory_bytes"].get<double>(), 1e9);
  EXPECT_EQ(json["stages"].size(), 5u);
  EXPECT_EQ(json["outputs"][0]["path"], (out / "town.tif").string());
  for (const auto& output : json["outputs"]) {
    EXPECT_EQ(fs::file_size(output["path"].get<std::string>()), output["bytes"].get<std::uintmax_t>());
  }
  EXPECT_TRUE(fs::exists(WorkOf(out) / "logs" / "worker-1.log"));
}

TEST_F(RunTest, RefusesASecondRunOfTheSameOutput) {
  const fs::path out = fixture_.NewFolder("out");
  const auto argv = RunFixture::RunArguments(sortie_, out / "town.tif", {"--workers", "1", "--quiet"});
  Subprocess first(argv, fixture_.Options());
  ASSERT_TRUE(AwaitMiddle(&first, WorkOf(out))) << first.Stderr();
  const Completed second = fixture_.Run(argv);
  EXPECT_EQ(second.exit_code, 1);
  EXPECT_THAT(second.stderr_text, HasSubstr("another 'trem run' is using"));
  const auto exit = first.Wait(kPatience);
  ASSERT_TRUE(exit.has_value());
  EXPECT_EQ(exit->code, 0) << first.Stderr();
  EXPECT_TRUE(fs::exists(out / "town.tif"));
}

TEST_F(RunTest, PlansWithoutRunning) {
  const Completed plan = fixture_.Run({BinaryPath("trem").string(), "plan", sortie_.string(), "--json"});
  ASSERT_EQ(plan.exit_code, 0) << plan.stderr_text;
  const auto json = nlohmann::json::parse(plan.stdout_text);
  EXPECT_EQ(json["frames"], kFrameCount);
  EXPECT_GE(json["windows"].get<int>(), 1);
  EXPECT_GT(json["memory_bytes"]["enhance"].get<double>(), 0.0);
}

}  // namespace
}  // namespace trem::testing
