// Goal: the real program binds, says where, answers, and ends cleanly on a signal, a Shutdown message or the end of its parent. Method:
// real processes and a real channel; a kill -9 between two questions.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <csignal>
#include <thread>

#include "proto/channel/dealer_channel.h"
#include "tests/support/loopback.h"
#include "tests/support/paths.h"
#include "tests/support/subprocess.h"

namespace trem::testing {
namespace {

using namespace std::chrono_literals;
using ::testing::HasSubstr;

class CoordinatorProcessTest : public ::testing::Test {
 protected:
  std::vector<std::string> Arguments() const {
    return {BinaryPath("trem-coordinator").string(),
            "--state",
            (folder / "state").string(),
            "--store",
            (folder / "store").string(),
            "--bind",
            "tcp://127.0.0.1:*",
            "--ready-file",
            (folder / "ready").string()};
  }
  // The endpoint from the ready file, once it is there.
  std::string Endpoint() const {
    for (int i = 0; i < 1000; ++i) {
      if (std::filesystem::exists(folder / "ready")) {
        const std::string text = FileContents(folder / "ready");
        return text.substr(0, text.find('\n'));
      }
      std::this_thread::sleep_for(10ms);
    }
    return "";
  }
  static v1::Envelope Ask(const std::string& endpoint, const v1::Envelope& question) {
    auto channel = DealerChannel::Connect(endpoint);
    if (!channel.ok() || !(*channel)->Send(question, 10s).ok()) return {};
    for (int i = 0; i < 100; ++i) {
      const auto answer = (*channel)->Receive(100ms);
      if (answer.ok() && answer->has_value()) return **answer;
    }
    return {};
  }
  TempDir folder;
};

TEST_F(CoordinatorProcessTest, RemembersAJobThroughAKillAndEndsCleanlyOnSigterm) {
  v1::Envelope submit;
  submit.mutable_submit_job()->set_job_id("job");
  submit.mutable_submit_job()->mutable_sortie()->mutable_source()->set_path("/data/leg");
  {
    Subprocess coordinator(Arguments());
    EXPECT_EQ(Ask(Endpoint(), submit).job_status().state(), v1::JOB_RUNNING) << coordinator.Stderr();
    coordinator.Signal(SIGKILL);
    ASSERT_TRUE(coordinator.Wait(10s).has_value());
  }
  std::filesystem::remove(folder / "ready");
  Subprocess coordinator(Arguments());
  v1::Envelope get;
  get.mutable_get_job()->set_job_id("job");
  EXPECT_EQ(Ask(Endpoint(), get).job_status().job_id(), "job") << coordinator.Stderr();
  coordinator.Signal(SIGTERM);
  const auto exit = coordinator.Wait(10s);
  ASSERT_TRUE(exit.has_value());
  EXPECT_EQ(exit->code, 0) << coordinator.Stderr();
}

TEST_F(CoordinatorProcessTest, ServesMetricsAndProbes) {
  std::vector<std::string> arguments = Arguments();
  arguments.insert(arguments.end(), {"--http", "127.0.0.1:0", "--log-format", "json"});
  Subprocess coordinator(arguments);
  v1::Envelope submit;
  submit.mutable_submit_job()->set_job_id("job");
  submit.mutable_submit_job()->mutable_sortie()->mutable_source()->set_path("/data/leg");
  ASSERT_TRUE(Ask(Endpoint(), submit).has_job_status()) << coordinator.Stderr();
  const std::string ready = FileContents(folder / "ready");
  const std::string url = ready.substr(ready.find('\n') + 1, ready.rfind('\n') - ready.find('\n') - 1);
  EXPECT_THAT(HttpGet(url, "/healthz"), HasSubstr("ok"));
  EXPECT_THAT(HttpGet(url, "/readyz"), HasSubstr("ready"));
  EXPECT_THAT(HttpGet(url, "/else"), HasSubstr("404"));
  std::string metrics;
  for (int i = 0; i < 100 && metrics.find("trem_jobs{state=\"running\"} 1") == std::string::npos; ++i) {  // They follow once a second.
    std::this_thread::sleep_for(100ms);
    metrics = HttpGet(url, "/metrics");
  }
  for (const char* line : {"trem_jobs{state=\"running\"} 1", "trem_tasks_waiting 1", "trem_workers 0", "trem_store_events_total ",
                           "trem_store_commit_seconds_count ", "trem_build_info{", "# HELP trem_tasks_waiting", "# TYPE trem_tasks_waiting gauge"}) {
    EXPECT_THAT(metrics, HasSubstr(line));
  }
  EXPECT_THAT(coordinator.Stderr(), HasSubstr("\"job\":\"job\""));
}

TEST_F(CoordinatorProcessTest, EndsWhenAClientAsksForItAfterSayingGoodbye) {
  Subprocess coordinator(Arguments());
  v1::Envelope shutdown;
  shutdown.mutable_shutdown();
  EXPECT_TRUE(Ask(Endpoint(), shutdown).has_bye());
  const auto exit = coordinator.Wait(10s);
  ASSERT_TRUE(exit.has_value());
  EXPECT_EQ(exit->code, 0);
}

TEST_F(CoordinatorProcessTest, EndsWithItsParentWhenAskedTo) {
  std::string command;
  for (const std::string& argument : Arguments()) command += "'" + argument + "' ";
  Subprocess parent({"sh", "-c", command + "--die-with-parent & wait"});
  ASSERT_FALSE(Endpoint().empty());
  ASSERT_EQ(parent.Descendants().size(), 1U);
  parent.Signal(SIGKILL);
  EXPECT_TRUE(parent.DescendantsAfter(10s).empty());
}

TEST_F(CoordinatorProcessTest, SaysWhoHoldsTheStateFolder) {
  Subprocess first(Arguments());
  ASSERT_FALSE(Endpoint().empty());
  const Completed second = RunProgram(Arguments(), 20s);
  EXPECT_EQ(second.exit_code, 4);
  EXPECT_THAT(second.stderr_text, HasSubstr("in use by process " + std::to_string(first.pid())));
}

TEST_F(CoordinatorProcessTest, ExplainsItsUsage) {
  EXPECT_EQ(RunProgram({BinaryPath("trem-coordinator").string()}, 20s).exit_code, 2);
  const Completed help = RunProgram({BinaryPath("trem-coordinator").string(), "--help"}, 20s);
  EXPECT_EQ(help.exit_code, 0);
  EXPECT_THAT(help.stdout_text, HasSubstr("--ready-file"));
}

}  // namespace
}  // namespace trem::testing
