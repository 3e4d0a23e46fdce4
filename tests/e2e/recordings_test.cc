// Goal: several recordings become one mosaic, aligned to each other, and adding one to a job that is done computes only its own windows and
// what depends on them. Method: two simulated sorties over the same ground with receivers that err differently, a real coordinator and
// worker; the coordinator's log tells what was computed, trem_score what the mosaic is worth.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <map>
#include <nlohmann/json.hpp>
#include <thread>

#include "coordinator/store/event_store.h"
#include "tests/e2e/run_fixture.h"

namespace trem::testing {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class Recordings : public ::testing::Test {
 protected:
  // A sortie over `truth` (empty: a terrain of its own), which another seed errs on in another way.
  fs::path Simulate(const std::string& name, int seed, const std::string& truth) const {
    const fs::path folder = fixture_.folder() / name;
    std::vector<std::string> argv = {BinaryPath("trem").string(),
                                     "simulate",
                                     "-o",
                                     folder.string(),
                                     "--quiet",
                                     "--width",
                                     "160",
                                     "--height",
                                     "120",
                                     "--frames",
                                     "40",
                                     "--seed",
                                     std::to_string(seed),
                                     "--speed-px",
                                     "3"};
    if (!truth.empty()) argv.push_back(truth);
    EXPECT_EQ(fixture_.Run(argv).exit_code, 0);
    return folder;
  }

  RunFixture fixture_;
};

TEST_F(Recordings, AreAlignedToEachOtherInOneMosaic) {
  const fs::path first = Simulate("first", 1, "");
  const fs::path second = Simulate("second", 7, (first / "truth" / "truth.tif").string());
  const fs::path mosaic = fixture_.folder() / "mosaic.tif";
  const Completed run = fixture_.Run(RunFixture::RunArguments(
      first / "sortie.textproto", mosaic, {"--quiet", "--also", (second / "sortie.textproto").string(), "--workers", "2"}));
  ASSERT_EQ(run.exit_code, 0) << run.stderr_text;
  // Receivers err by a metre in directions of their own; what both recordings show must lie in one place all the same.
  const Completed score =
      fixture_.Run({BinaryPath("trem_score").string(), "--simulation", first.string(), "--mosaic", mosaic.string(), "--json"});
  ASSERT_EQ(score.exit_code, 0) << score.stderr_text;
  const nlohmann::json figures = nlohmann::json::parse(score.stdout_text);
  EXPECT_GE(figures.at("coverage").get<double>(), 0.97) << score.stdout_text;
  EXPECT_GE(figures.at("gain_db").get<double>(), 3.0) << score.stdout_text;
  EXPECT_LE(figures.at("distortion_p95_px").get<double>(), 0.5) << score.stdout_text;
}

TEST_F(Recordings, AreInspectedAndPlannedAllOfThem) {
  const fs::path first = Simulate("first", 1, ""), other = fixture_.SimulateSortie("other", 12, {"--width", "160", "--height", "120"});
  const std::string spec = (first / "sortie.textproto").string(), more = "more=" + (other / "sortie.textproto").string();
  const Completed inspect = fixture_.Run({BinaryPath("trem").string(), "inspect", spec, "--quiet", "--json", "--set", more});
  ASSERT_EQ(inspect.exit_code, 0) << inspect.stderr_text;
  const nlohmann::json recordings = nlohmann::json::parse(inspect.stdout_text).at("recordings");
  ASSERT_EQ(recordings.size(), 2U);
  EXPECT_EQ(recordings[0].at("frames"), 40);
  EXPECT_EQ(recordings[1].at("frames"), 12);
  const auto windows = [&](const std::vector<std::string>& options) {
    std::vector<std::string> argv = {BinaryPath("trem").string(), "plan", spec, "--json"};
    argv.insert(argv.end(), options.begin(), options.end());
    const Completed plan = fixture_.Run(argv);
    EXPECT_EQ(plan.exit_code, 0) << plan.stderr_text;
    return nlohmann::json::parse(plan.stdout_text).at("windows").get<int>();
  };
  EXPECT_EQ(windows({"--set", more}), 2 * windows({})) << "both recordings are shorter than a window, over the same ROIs";
}

TEST_F(Recordings, OfAnotherSensorAreRefusedByName) {
  const fs::path first = Simulate("first", 1, "");
  const fs::path other = fixture_.SimulateSortie("other", 12, {"--width", "96", "--height", "72"});
  const Completed run = fixture_.Run(RunFixture::RunArguments(first / "sortie.textproto", fixture_.folder() / "mosaic.tif",
                                                              {"--quiet", "--also", (other / "sortie.textproto").string()}));
  EXPECT_EQ(run.exit_code, 3);
  EXPECT_THAT(run.stderr_text, HasSubstr("96 x 72 px"));
  EXPECT_THAT(run.stderr_text, HasSubstr("one sensor"));
}

// Tasks committed so far by kind.
std::map<v1::TaskKind, int> Computed(const fs::path& state) {
  std::map<v1::TaskKind, int> counts;
  const auto log = EventStore::Open(state);
  EXPECT_TRUE(log.ok()) << log.status().message();
  if (!log.ok()) return counts;
  const Status read = (*log)->Replay([&](std::int64_t, const v1::LogEvent& event) -> Status {
    if (event.has_task_committed()) ++counts[event.task_committed().kind()];
    return {};
  });
  EXPECT_TRUE(read.ok()) << read.message();
  return counts;
}

TEST_F(Recordings, AddedToAJobThatIsDoneOnlyTheirOwnWindowsAreEnhanced) {
  const fs::path first = Simulate("first", 1, "");
  const fs::path second = Simulate("second", 7, (first / "truth" / "truth.tif").string());
  const fs::path state = fixture_.folder() / "state", store = fixture_.folder() / "store";
  const auto serve = [&](const std::vector<std::string>& sortie, const std::string& job) {
    const fs::path ready = fixture_.folder() / ("ready-" + job);
    Subprocess coordinator({BinaryPath("trem-coordinator").string(), "--state", state.string(), "--store", store.string(), "--bind",
                            "tcp://127.0.0.1:*", "--ready-file", ready.string()},
                           fixture_.Options());
    for (int i = 0; i < 2000 && !fs::exists(ready); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
    ASSERT_TRUE(fs::exists(ready)) << coordinator.Stderr();
    SubprocessOptions options = fixture_.Options();
    const std::string endpoint = Lines(FileContents(ready)).at(0);
    options.environment.push_back("TREM_COORDINATOR=" + endpoint);
    std::vector<std::string> submit = {BinaryPath("trem").string(), "submit", "--job-id", job};
    submit.insert(submit.end(), sortie.begin(), sortie.end());
    const Completed submitted = RunProgram(submit, std::chrono::minutes(5), options);
    ASSERT_EQ(submitted.exit_code, 0) << submitted.stderr_text;
    Subprocess worker({BinaryPath("trem-worker").string(), "serve", "--coordinator", endpoint, "--store", store.string()},
                      fixture_.Options());
    const Completed watch = RunProgram({BinaryPath("trem").string(), "watch", job}, std::chrono::minutes(5), options);
    EXPECT_EQ(watch.exit_code, 0) << watch.stderr_text;
    worker.Signal(SIGTERM);
    EXPECT_TRUE(worker.Wait(std::chrono::seconds(60)).has_value());
    coordinator.Signal(SIGTERM);
    EXPECT_TRUE(coordinator.Wait(std::chrono::seconds(60)).has_value());
  };
  serve({(first / "sortie.textproto").string()}, "one");
  const auto alone = Computed(state);
  ASSERT_GT(alone.at(v1::ENHANCE), 0);
  serve({(first / "sortie.textproto").string(), "--also", (second / "sortie.textproto").string()}, "both");
  const auto both = Computed(state);
  EXPECT_EQ(both.at(v1::INGEST) - alone.at(v1::INGEST), 1) << "sources are always looked at again";
  // The second sortie has as many frames of the same size, so as many windows.
  EXPECT_EQ(both.at(v1::ENHANCE) - alone.at(v1::ENHANCE), alone.at(v1::ENHANCE));
  EXPECT_EQ(both.at(v1::ALIGN) - alone.at(v1::ALIGN), 1);
  // Another distance of the pixels needs no window again.
  serve({(first / "sortie.textproto").string(), "--also", (second / "sortie.textproto").string(), "--gsd", "0.2"}, "coarser");
  const auto coarser = Computed(state);
  EXPECT_EQ(coarser.at(v1::ENHANCE), both.at(v1::ENHANCE));
  EXPECT_EQ(coarser.at(v1::ALIGN) - both.at(v1::ALIGN), 1);
}

}  // namespace
}  // namespace trem::testing
