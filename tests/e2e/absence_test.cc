// Goal: whoever follows a job goes on following it when the coordinator is away for a while, and a command that was itself stopped does not
// take that time for the coordinator's silence. Method: a coordinator that is killed and started again at the same address; a program that
// is stopped between its question and the answer, for longer than its patience.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <nlohmann/json.hpp>
#include <thread>

#include "proto/channel/router_channel.h"
#include "tests/e2e/service_fixture.h"

namespace trem::testing {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using ::testing::HasSubstr;

// Longer than a question's patience, which is 5 s.
constexpr seconds kLong{7};

class AbsenceTest : public ServiceTest {
 protected:
  std::unique_ptr<Subprocess> Follow(const std::vector<std::string>& arguments) const {
    std::vector<std::string> argv = {BinaryPath("trem").string()};
    argv.insert(argv.end(), arguments.begin(), arguments.end());
    SubprocessOptions options = fixture_.Options();
    options.environment.push_back("TREM_COORDINATOR=" + endpoint_);
    return std::make_unique<Subprocess>(argv, options);
  }
};

TEST_F(AbsenceTest, WatchAndLogsOutlastARestartOfTheCoordinator) {
  Start();
  Submit("town", 8);
  const auto watch = Follow({"watch", "town", "--json"});
  const auto logs = Follow({"logs", "town", "--follow"});
  // Both have had an answer when they have said something.
  for (int i = 0; i < 3000 && (watch->Stderr().empty() || logs->Stdout().empty()); ++i) std::this_thread::sleep_for(milliseconds(10));
  ASSERT_FALSE(watch->Stderr().empty());
  ASSERT_FALSE(logs->Stdout().empty());
  coordinator_->Signal(SIGKILL);
  ASSERT_TRUE(coordinator_->Wait(seconds(30)).has_value());
  std::this_thread::sleep_for(kLong);
  std::filesystem::remove(ready_);
  bind_ = endpoint_;
  Start();
  const auto worker = Worker();
  const auto watched = watch->Wait(std::chrono::minutes(5));
  const auto logged = logs->Wait(std::chrono::minutes(5));
  ASSERT_TRUE(watched && logged) << watch->Stderr() << logs->Stderr();
  EXPECT_EQ(watched->code, 0) << watch->Stderr();
  EXPECT_EQ(nlohmann::json::parse(watch->Stdout())["state"], "done");
  EXPECT_THAT(watch->Stderr(), HasSubstr("warning: no coordinator answers at " + endpoint_));
  EXPECT_EQ(logged->code, 0) << logs->Stderr();
  EXPECT_THAT(logs->Stdout(), HasSubstr("JOB_DONE"));
}

TEST_F(AbsenceTest, WhoeverNeverAnsweredIsNotWaitedFor) {
  endpoint_ = "tcp://127.0.0.1:1";
  const Completed watch = Trem({"watch", "town"});
  EXPECT_EQ(watch.exit_code, 4);
  EXPECT_THAT(watch.stderr_text, HasSubstr("is trem-coordinator running there?"));
}

TEST_F(AbsenceTest, TimeInWhichACommandWasStoppedIsNobodysSilence) {
  const auto router = std::move(RouterChannel::Bind("tcp://127.0.0.1:*")).value();
  endpoint_ = router->endpoint();
  const auto list = Follow({"list", "--json"});
  std::optional<RouterChannel::Incoming> question;
  for (int i = 0; i < 30 && !question; ++i) question = router->Poll(seconds(1));
  ASSERT_TRUE(question && question->envelope.ok() && question->envelope->has_list_jobs());
  list->Signal(SIGSTOP);
  std::this_thread::sleep_for(kLong);
  v1::Envelope answer;
  answer.mutable_job_list();
  ASSERT_TRUE(router->Send(question->peer, answer));
  list->Signal(SIGCONT);
  const auto exit = list->Wait(seconds(30));
  ASSERT_TRUE(exit.has_value());
  EXPECT_EQ(exit->code, 0) << list->Stderr();
  EXPECT_EQ(list->Stdout(), "[]\n");
}

}  // namespace
}  // namespace trem::testing
