// Goal: whatever a task does to its process ends the task alone, with a reason, and the next one is computed. Method: a compute process
// that crashes, hangs, fills memory or is deaf on demand (fake_compute.cc).
#include "worker/app/compute_process.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "worker/app/attempt_log.h"

namespace trem {
namespace {

using std::chrono::milliseconds;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

class ComputeProcessTest : public ::testing::Test {
 protected:
  static ComputeProcessOptions Options() {
    ComputeProcessOptions options;
    options.argv = {TREM_FAKE_COMPUTE};
    options.cancel_grace = std::chrono::seconds(5);
    return options;
  }
  TaskOutcome Run(const std::string& what) {
    v1::TaskSpec spec;
    spec.set_key(what);
    spec.set_kind(v1::ENHANCE);
    return process_->Run(spec, [this](double fraction) {
      if (fraction > 0.0) largest_ = std::max(largest_.load(), fraction);
      return !cancelled_;
    });
  }
  void ExpectWorks() {
    const TaskOutcome outcome = Run("work");
    ASSERT_TRUE(outcome.result.ok()) << outcome.result.status().ToString();
    EXPECT_EQ(outcome.result->outputs(0).name(), "work");
    EXPECT_GT(outcome.peak_memory_bytes, 0U);
  }

  std::unique_ptr<ComputeProcess> process_ = std::make_unique<ComputeProcess>(Options());
  std::atomic<bool> cancelled_{false};
  std::atomic<double> largest_{0.0};
};

TEST_F(ComputeProcessTest, ComputesTaskAfterTaskAndReportsProgress) {
  ExpectWorks();
  EXPECT_EQ(largest_, 0.5);
  ExpectWorks();
}

TEST_F(ComputeProcessTest, StartsBeforeTheFirstTaskAndFailsWithIt) {
  process_->Start();
  ExpectWorks();
  process_->Start();  // It is there.
  ExpectWorks();
  ComputeProcessOptions options = Options();
  options.argv = {"/nowhere/trem-worker"};
  process_ = std::make_unique<ComputeProcess>(options);
  process_->Start();
  EXPECT_THAT(Run("work").result.status().message(), HasSubstr("cannot start /nowhere/trem-worker"));
}

TEST_F(ComputeProcessTest, TellsARunningTaskHowManyProcessorsItMayUseAndTheNextOneBeginsWithOne) {
  process_->SetProcessors(2);
  const TaskOutcome two = Run("two");
  EXPECT_TRUE(two.result.ok()) << two.result.status().ToString();
  process_->SetProcessors(1);
  const TaskOutcome one = Run("one");
  EXPECT_TRUE(one.result.ok()) << one.result.status().ToString();
}

TEST_F(ComputeProcessTest, HandsOnWhatTheChildWritesToStderrItsLastWordsToo) {
  AttemptLog log;
  ComputeProcessOptions options = Options();
  options.on_stderr = [&log](std::string_view bytes) { log.Add(bytes); };
  process_ = std::make_unique<ComputeProcess>(options);
  for (const char* what : {"mutter", "last-words"}) {
    log.Begin();
    EXPECT_EQ(Run(what).result.ok(), std::string(what) == "mutter");
    process_.reset();  // Waits for the child; what it wrote is in the pipe.
    EXPECT_THAT(log.Take(true), ElementsAre("a corrupt frame", "half a line")) << what;
    process_ = std::make_unique<ComputeProcess>(options);
  }
}

TEST(AttemptLog, IsBoundedAndSaysWhatItLeftOut) {
  AttemptLog log;
  log.Begin();
  for (std::size_t i = 0; i < AttemptLog::kLinesMax + 5; ++i) log.Add(std::string(5000, 'x') + "\xff\n");
  const std::vector<std::string> lines = log.Take(false);
  ASSERT_EQ(lines.size(), AttemptLog::kLinesMax);
  EXPECT_EQ(lines[0].size(), AttemptLog::kLineBytesMax);
  EXPECT_THAT(log.Take(true), ElementsAre("... and 5 more lines"));
  log.Begin();
  log.Add("not UTF-8: \xff\n");
  EXPECT_THAT(log.Take(true), ElementsAre("not UTF-8: \xef\xbf\xbd"));
}

TEST_F(ComputeProcessTest, TurnsEveryDeathIntoAFailureThatSaysHowAndGoesOn) {
  struct Case {
    const char* what;
    StatusCode code;
    const char* words;
  };
  for (const Case& c :
       {Case{"crash", StatusCode::kFailed, "ended by signal 11"}, Case{"abort", StatusCode::kFailed, "ended by signal 6"},
        Case{"exit", StatusCode::kFailed, "exited with code 7"}, Case{"out-of-memory", StatusCode::kExhausted, "more memory than there is"},
        Case{"allocate", StatusCode::kExhausted, "out of memory"}}) {
    SCOPED_TRACE(c.what);
    const TaskOutcome outcome = Run(c.what);
    EXPECT_EQ(outcome.result.status().code(), c.code);
    EXPECT_THAT(outcome.result.status().message(), HasSubstr(c.words));
    ExpectWorks();
  }
}

TEST_F(ComputeProcessTest, PassesFailuresOnWithTheDamagedInputs) {
  const TaskOutcome outcome = Run("fail");
  EXPECT_EQ(outcome.result.status().code(), StatusCode::kCorrupt);
  EXPECT_EQ(outcome.result.status().message(), "window.pb is damaged");
  EXPECT_THAT(outcome.bad_artefacts, ElementsAre(std::string(64, 'a')));
}

TEST_F(ComputeProcessTest, KillsWhatReportsNothingForTooLong) {
  ComputeProcessOptions options = Options();
  options.silence_max = std::chrono::seconds(5);
  process_ = std::make_unique<ComputeProcess>(options);
  EXPECT_THAT(Run("hang").result.status().message(), HasSubstr("made no progress"));
  ExpectWorks();
}

TEST_F(ComputeProcessTest, KillsWhatTakesTooLongHoweverBusy) {
  ComputeProcessOptions options = Options();
  options.task_max = std::chrono::seconds(5);
  process_ = std::make_unique<ComputeProcess>(options);
  EXPECT_THAT(Run("deaf").result.status().message(), HasSubstr("took more than"));
  ExpectWorks();
}

TEST_F(ComputeProcessTest, CancelsThePoliteByAskingAndTheDeafByKilling) {
  cancelled_ = true;
  const TaskOutcome polite = Run("obedient");
  EXPECT_EQ(polite.result.status().message(), "as asked");
  for (const char* what : {"deaf", "hang"}) {
    const TaskOutcome outcome = Run(what);
    EXPECT_EQ(outcome.result.status().code(), StatusCode::kCancelled) << what;
    EXPECT_THAT(outcome.result.status().message(), HasSubstr("did not stop")) << what;
  }
  cancelled_ = false;
  ExpectWorks();
}

TEST_F(ComputeProcessTest, SaysWhenTheProgramCannotBeStarted) {
  ComputeProcessOptions options = Options();
  options.argv = {"/nowhere/compute"};
  process_ = std::make_unique<ComputeProcess>(options);
  const Status status = Run("work").result.status();
  EXPECT_EQ(status.code(), StatusCode::kNotFound);
  EXPECT_THAT(status.message(), HasSubstr("/nowhere/compute"));
}

TEST(ComputeFrameReader, RefusesWhatIsNoFrame) {
  int pair[2];
  ASSERT_EQ(::socketpair(AF_UNIX, SOCK_STREAM, 0, pair), 0);
  ASSERT_EQ(::send(pair[0], "Xabcdefgh", 9, 0), 9);
  ComputeFrameReader reader;
  EXPECT_TRUE(reader.ReadAvailable(pair[1]));
  EXPECT_EQ(reader.Next().status().code(), StatusCode::kCorrupt);
  ::close(pair[0]);
  EXPECT_FALSE(reader.ReadAvailable(pair[1]));
  ::close(pair[1]);
}

}  // namespace
}  // namespace trem
