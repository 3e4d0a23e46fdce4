// Goal: the commands for a running coordinator do what they say and tell errors apart. Method: a real coordinator and a real worker over
// TCP, one small job from submit to fetch.
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
using ::testing::Key;

class RemoteTest : public ::testing::Test {
 protected:
  void SetUp() override {
    for (int i = 0; i < 2000 && !fs::exists(ready_); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
    ASSERT_TRUE(fs::exists(ready_)) << coordinator_.Stderr();
    endpoint_ = Lines(FileContents(ready_)).at(0);
  }
  Completed Trem(std::vector<std::string> arguments) const {
    arguments.insert(arguments.begin(), BinaryPath("trem").string());
    SubprocessOptions options = fixture_.Options();
    options.environment.push_back("TREM_COORDINATOR=" + endpoint_);
    return RunProgram(arguments, std::chrono::minutes(5), options);
  }

  RunFixture fixture_;
  fs::path ready_ = fixture_.folder() / "ready";
  fs::path store_ = fixture_.folder() / "store";
  Subprocess coordinator_{{BinaryPath("trem-coordinator").string(), "--state", (fixture_.folder() / "state").string(), "--store",
                           store_.string(), "--bind", "tcp://127.0.0.1:*", "--ready-file", ready_.string()},
                          fixture_.Options()};
  std::string endpoint_;
};

TEST_F(RemoteTest, TakesAJobFromSubmitToFetch) {
  const fs::path sortie = fixture_.SimulateSortie("sortie", 16);
  const Completed submit = Trem({"submit", (sortie / "sortie.textproto").string(), "--job-id", "town-1"});
  ASSERT_EQ(submit.exit_code, 0) << submit.stderr_text;
  EXPECT_EQ(submit.stdout_text, "town-1\n");

  const fs::path out = fixture_.NewFolder("out");
  const Completed early = Trem({"fetch", "town-1", "-o", (out / "town.tif").string()});
  EXPECT_EQ(early.exit_code, 1);
  EXPECT_THAT(early.stderr_text, HasSubstr("is running"));

  Subprocess worker({BinaryPath("trem-worker").string(), "serve", "--coordinator", endpoint_, "--store", store_.string()},
                    fixture_.Options());
  const Completed watch = Trem({"watch", "town-1", "--json"});
  EXPECT_EQ(watch.exit_code, 0) << watch.stderr_text;
  EXPECT_EQ(nlohmann::json::parse(watch.stdout_text)["state"], "done");
  EXPECT_EQ(nlohmann::json::parse(Trem({"workers", "--json"}).stdout_text).size(), 1u);
  EXPECT_THAT(Trem({"list"}).stdout_text, HasSubstr("town-1"));
  EXPECT_THAT(Trem({"status", "town-1"}).stdout_text, HasSubstr("enhance"));

  const Completed fetch = Trem({"fetch", "town-1", "-o", (out / "town.tif").string()});
  EXPECT_EQ(fetch.exit_code, 0) << fetch.stderr_text;
  EXPECT_THAT(FilesIn(out), Contains(Key("town.tif")));
  EXPECT_THAT(FilesIn(out), Contains(Key("town_chain.csv")));
  worker.Signal(SIGTERM);
  const auto exit = worker.Wait(std::chrono::seconds(30));
  ASSERT_TRUE(exit.has_value());
  EXPECT_EQ(exit->code, 0) << worker.Stderr();
}

TEST_F(RemoteTest, TellsOperatorsWhatGoesOnAndRestoresABackup) {
  const fs::path sortie = fixture_.SimulateSortie("sortie", 16);
  ASSERT_EQ(Trem({"submit", (sortie / "sortie.textproto").string(), "--job-id", "town-1", "--priority", "3"}).exit_code, 0);
  const auto top = nlohmann::json::parse(Trem({"top", "--json"}).stdout_text);
  EXPECT_EQ(top["jobs"][0]["job_id"], "town-1");
  EXPECT_THAT(Trem({"top"}).stdout_text, HasSubstr("1 running, 0 other jobs; 0 workers"));
  const Completed backup = Trem({"backup", "before", "--json"});
  ASSERT_EQ(backup.exit_code, 0) << backup.stderr_text;
  const std::string copy = nlohmann::json::parse(backup.stdout_text)["path"];
  EXPECT_TRUE(fs::exists(copy));
  EXPECT_EQ(fs::status(copy).permissions() & fs::perms::all, fs::perms::owner_read | fs::perms::owner_write);

  {
    Subprocess worker({BinaryPath("trem-worker").string(), "serve", "--coordinator", endpoint_, "--store", store_.string()},
                      fixture_.Options());
    const Completed logs = Trem({"logs", "town-1", "--follow"});
    EXPECT_EQ(logs.exit_code, 0) << logs.stderr_text;
    EXPECT_THAT(logs.stdout_text, HasSubstr("[INGEST #1] handed out"));
    EXPECT_THAT(logs.stdout_text, HasSubstr("[EXPORT #1] result after"));
    EXPECT_THAT(logs.stdout_text, HasSubstr("JOB_DONE"));
    const Completed one = Trem({"logs", "town-1", "--task", "ingest", "--json"});
    EXPECT_EQ(nlohmann::json::parse(Lines(one.stdout_text).at(0))["task"], "INGEST");
    EXPECT_EQ(Trem({"logs", "town-2"}).exit_code, 3);
  }
  EXPECT_EQ(Trem({"submit", (sortie / "sortie.textproto").string(), "--job-id", "later"}).exit_code, 0);
  coordinator_.Signal(SIGTERM);
  ASSERT_TRUE(coordinator_.Wait(std::chrono::seconds(30)).has_value());
  const Completed restored =
      RunProgram({BinaryPath("trem-coordinator").string(), "restore", copy, "--state", (fixture_.folder() / "state").string()},
                 std::chrono::minutes(1), fixture_.Options());
  EXPECT_EQ(restored.exit_code, 0) << restored.stderr_text;
  EXPECT_THAT(restored.stdout_text, HasSubstr("1 events restored"));
  Subprocess again({BinaryPath("trem-coordinator").string(), "--state", (fixture_.folder() / "state").string(), "--store", store_.string(),
                    "--bind", endpoint_},
                   fixture_.Options());
  EXPECT_THAT(Trem({"list"}).stdout_text, HasSubstr("town-1"));
  EXPECT_EQ(Trem({"status", "later"}).exit_code, 3);
  Subprocess worker({BinaryPath("trem-worker").string(), "serve", "--coordinator", endpoint_, "--store", store_.string()},
                    fixture_.Options());
  EXPECT_EQ(Trem({"watch", "town-1", "--quiet"}).exit_code, 0) << "what was computed since the backup is computed again";
}

TEST_F(RemoteTest, StreamsArtefactsToAWorkerThatSharesNothing) {
  const fs::path sortie = fixture_.SimulateSortie("sortie", 16);
  const fs::path out = fixture_.NewFolder("out");
  ASSERT_EQ(Trem({"run", (sortie / "sortie.textproto").string(), "-o", (out / "local.tif").string()}).exit_code, 0);
  ASSERT_EQ(Trem({"submit", (sortie / "sortie.textproto").string(), "--job-id", "town-1"}).exit_code, 0);
  const fs::path temporary = fixture_.NewFolder("temporary");
  SubprocessOptions options = fixture_.Options();
  options.environment.push_back("TMPDIR=" + temporary.string());
  const std::vector<std::string> argv = {BinaryPath("trem-worker").string(), "serve", "--coordinator", endpoint_};
  Subprocess first(argv, options);
  Subprocess second(argv, options);
  const Completed watch = Trem({"watch", "town-1"});
  EXPECT_EQ(watch.exit_code, 0) << watch.stderr_text << first.Stderr();
  const Completed fetch = Trem({"fetch", "town-1", "-o", (out / "streamed.tif").string()});
  EXPECT_EQ(fetch.exit_code, 0) << fetch.stderr_text;
  EXPECT_EQ(FileContents(out / "streamed.tif"), FileContents(out / "local.tif"));
  EXPECT_FALSE(fs::exists(out / "streamed.tif.fetch"));
  for (Subprocess* worker : {&first, &second}) {
    worker->Signal(SIGTERM);
    ASSERT_TRUE(worker->Wait(std::chrono::seconds(30)).has_value());
  }
  EXPECT_TRUE(NamesIn(temporary).empty());
}

TEST_F(RemoteTest, UploadsASortieThatTheWorkersCannotRead) {
  // Two recordings, whose frames and telemetry have the same names.
  const fs::path sortie = fixture_.SimulateSortie("sortie", 16), second_sortie = fixture_.SimulateSortie("second", 12);
  const fs::path out = fixture_.NewFolder("out");
  const std::string spec = (sortie / "sortie.textproto").string(), second_spec = (second_sortie / "sortie.textproto").string();
  ASSERT_EQ(Trem({"run", spec, "--also", second_spec, "-o", (out / "local.tif").string()}).exit_code, 0);
  const Completed submit = Trem({"submit", spec, "--also", second_spec, "--job-id", "town-1", "--upload"});
  ASSERT_EQ(submit.exit_code, 0) << submit.stderr_text;
  fs::rename(sortie, fixture_.folder() / "out-of-reach");
  fs::rename(second_sortie, fixture_.folder() / "out-of-reach-too");
  const std::vector<std::string> argv = {BinaryPath("trem-worker").string(), "serve", "--coordinator", endpoint_};
  Subprocess first(argv, fixture_.Options());
  Subprocess second(argv, fixture_.Options());
  const Completed watch = Trem({"watch", "town-1"});
  EXPECT_EQ(watch.exit_code, 0) << watch.stderr_text << first.Stderr();
  ASSERT_EQ(Trem({"fetch", "town-1", "-o", (out / "uploaded.tif").string()}).exit_code, 0);
  EXPECT_EQ(FileContents(out / "uploaded.tif"), FileContents(out / "local.tif"));
}

// What only a removed job had leaves the store, what another job has stays, and neither comes back with a restart.
TEST_F(RemoteTest, RemovesAJobAndWhatOnlyItHad) {
  const fs::path sortie = fixture_.SimulateSortie("sortie", 16);
  Subprocess worker({BinaryPath("trem-worker").string(), "serve", "--coordinator", endpoint_, "--store", store_.string()},
                    fixture_.Options());
  const std::string spec = (sortie / "sortie.textproto").string();
  ASSERT_EQ(Trem({"submit", spec, "--job-id", "kept"}).exit_code, 0);
  ASSERT_EQ(Trem({"submit", spec, "--job-id", "gone", "--set", "mosaic.estimator=median"}).exit_code, 0);
  EXPECT_NE(Trem({"remove", "gone"}).exit_code, 0) << "it runs";
  ASSERT_EQ(Trem({"watch", "kept"}).exit_code, 0);
  ASSERT_EQ(Trem({"watch", "gone"}).exit_code, 0);
  const auto objects = [&] {
    std::vector<fs::path> found;
    for (const auto& entry : fs::recursive_directory_iterator(store_ / "objects")) {
      if (entry.is_regular_file()) found.push_back(entry.path());
    }
    return found;
  };
  const std::size_t before = objects().size();
  for (const fs::path& object : objects()) fs::last_write_time(object, fs::file_time_type::clock::now() - std::chrono::hours(1));
  const Completed removed = Trem({"remove", "gone"});
  ASSERT_EQ(removed.exit_code, 0) << removed.stderr_text;
  for (int i = 0; i < 3000 && objects().size() == before; ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  EXPECT_LT(objects().size(), before);
  EXPECT_THAT(Trem({"status", "gone"}).stderr_text, HasSubstr("no job"));
  EXPECT_NE(Trem({"remove", "gone"}).exit_code, 0);
  const fs::path out = fixture_.NewFolder("out");
  EXPECT_EQ(Trem({"fetch", "kept", "-o", (out / "kept.tif").string()}).exit_code, 0);

  coordinator_.Signal(SIGTERM);
  ASSERT_TRUE(coordinator_.Wait(std::chrono::seconds(30)).has_value());
  fs::remove(ready_);
  const Subprocess again({BinaryPath("trem-coordinator").string(), "--state", (fixture_.folder() / "state").string(), "--store",
                          store_.string(), "--bind", endpoint_, "--ready-file", ready_.string()},
                         fixture_.Options());
  for (int i = 0; i < 2000 && !fs::exists(ready_); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  EXPECT_THAT(Trem({"status", "gone"}).stderr_text, HasSubstr("no job"));
  EXPECT_EQ(nlohmann::json::parse(Trem({"status", "kept", "--json"}).stdout_text)["state"], "done");
}

TEST_F(RemoteTest, CancelsAJob) {
  const fs::path sortie = fixture_.SimulateSortie("sortie", 3);
  ASSERT_EQ(Trem({"submit", (sortie / "sortie.textproto").string(), "--job-id", "town-1"}).exit_code, 0);
  const Completed cancel = Trem({"cancel", "town-1", "--json"});
  EXPECT_EQ(cancel.exit_code, 0) << cancel.stderr_text;
  EXPECT_EQ(nlohmann::json::parse(cancel.stdout_text)["state"], "cancelled");
  const Completed watch = Trem({"watch", "town-1"});
  EXPECT_EQ(watch.exit_code, 1);
  EXPECT_THAT(watch.stderr_text, HasSubstr("cancelled"));
}

TEST_F(RemoteTest, ListsNothingWhenThereIsNothing) {
  const Completed list = Trem({"list", "--json"});
  EXPECT_EQ(list.exit_code, 0) << list.stderr_text;
  EXPECT_EQ(list.stdout_text, "[]\n");
  EXPECT_EQ(Trem({"workers"}).exit_code, 0);
}

TEST_F(RemoteTest, SaysThatAJobIsNotKnown) {
  for (const char* command : {"status", "watch", "cancel"}) {
    const Completed unknown = Trem({command, "no-such-job"});
    EXPECT_EQ(unknown.exit_code, 3) << command;
    EXPECT_EQ(Lines(unknown.stderr_text).size(), 1u) << unknown.stderr_text;
    EXPECT_THAT(unknown.stderr_text, HasSubstr("no-such-job"));
  }
}

}  // namespace
}  // namespace trem::testing
