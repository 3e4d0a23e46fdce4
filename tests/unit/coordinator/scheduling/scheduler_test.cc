// Goal: every rule of the scheduler that Scheduler's comment states, one test each. Method: a scheduler fed by hand with a clock that
// stands still, fake results, and a look at the effects; a rule that is removed makes its test fail.
#include "coordinator/scheduling/scheduler.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>

#include "tests/unit/coordinator/scheduling/fake_tasks.h"

namespace trem::testing {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

std::vector<std::string> Titles(const std::vector<DispatchEffect>& dispatches) {
  std::vector<std::string> titles;
  for (const DispatchEffect& dispatch : dispatches) titles.push_back(TitleOf(dispatch));
  return titles;
}

DispatchEffect OnlyDispatch(const std::vector<Effect>& effects) {
  const auto dispatches = Only<DispatchEffect>(effects);
  TREM_CHECK_MSG(dispatches.size() == 1, std::to_string(dispatches.size()) + " dispatches");
  return dispatches[0];
}

TEST(SchedulerTest, UnfoldsAJobStageByStageInPlanOrder) {
  Bench bench;
  bench.Hello("w1");
  const auto done = bench.RunAll(bench.Submit("job"));
  EXPECT_THAT(Titles(done), ElementsAre("INGEST", "ENHANCE window 0", "ENHANCE window 1", "ENHANCE window 2", "ENHANCE window 3", "ALIGN",
                                        "COMPOSITE tile 0", "COMPOSITE tile 1", "COMPOSITE tile 2", "EXPORT"));
  const v1::JobStatus status = bench.Status("job");
  EXPECT_EQ(status.state(), v1::JOB_DONE);
  ASSERT_THAT(status.outputs(), SizeIs(1));
  EXPECT_EQ(status.outputs(0).name(), "mosaic.tif");
  EXPECT_EQ(status.fraction(), 1.0);
  EXPECT_EQ(status.peak_memory_bytes(), 1'000U + v1::EXPORT);
  EXPECT_EQ(done[5].task.inputs_size(), 1 + static_cast<int>(kFakeWindowCount)) << "ALIGN reads every window";
}

TEST(SchedulerTest, TakesJobsInTheOrderTheyWereSubmitted) {
  Bench bench;
  bench.Submit("zebra", "one");
  bench.Submit("ape", "two");
  const auto done = bench.RunAll(bench.Hello("w1"));
  ASSERT_THAT(done, SizeIs(2 * kFakeTaskCount));
  for (std::size_t i = 0; i < done.size(); ++i) EXPECT_EQ(FakeSortieNameOf(done[i].task), i < kFakeTaskCount ? "one" : "two");
}

TEST(SchedulerTest, GivesAWorkerNoMoreThanItsCredit) {
  Bench bench;
  bench.Hello("w1", {}, 2);
  const auto ingest = OnlyDispatch(bench.Submit("job"));
  EXPECT_THAT(Only<DispatchEffect>(bench.Done(ingest)), SizeIs(2));
}

TEST(SchedulerTest, PrefersTheWorkerWithTheFewestTasks) {
  Bench bench;
  bench.Hello("a", {}, 8);
  bench.Hello("b", {}, 8);
  const auto enhances = Only<DispatchEffect>(bench.Done(OnlyDispatch(bench.Submit("job"))));
  ASSERT_THAT(enhances, SizeIs(4));
  std::map<std::string, int> counts;
  for (const DispatchEffect& dispatch : enhances) ++counts[dispatch.worker_id];
  EXPECT_EQ(counts["a"], 2);
  EXPECT_EQ(counts["b"], 2);
}

TEST(SchedulerTest, SendsATaskOnlyWhereItsMemoryFitsAndSaysSoWhenItFitsNowhere) {
  Bench bench;
  bench.Hello("small", {}, 1, 1 << 20);
  EXPECT_THAT(Only<DispatchEffect>(bench.Submit("job")), IsEmpty());
  const v1::JobStatus status = bench.Status("job");
  ASSERT_THAT(status.notes(), SizeIs(1));
  EXPECT_EQ(status.notes(0).code(), "waiting_for_memory");
  const DispatchEffect ingest = OnlyDispatch(bench.Hello("tall", {}, 1, 1ULL << 40));
  EXPECT_EQ(ingest.worker_id, "tall");
  EXPECT_THAT(bench.Status("job").notes(), IsEmpty());
}

TEST(SchedulerTest, WritesDownAnAttemptBeforeItsDispatchAndAResultBeforeItsAck) {
  Bench bench;
  bench.Hello("w1");
  const std::vector<Effect> submitted = bench.Submit("job");
  std::vector<Effect> effects = submitted;
  const std::vector<Effect> done = bench.Done(OnlyDispatch(submitted));
  effects.insert(effects.end(), done.begin(), done.end());
  std::set<std::pair<std::string, std::uint32_t>> started;
  std::set<std::string> committed;
  int checked = 0;
  for (const Effect& effect : effects) {
    if (const auto* append = std::get_if<AppendEffect>(&effect)) {
      if (append->event.has_attempt_started()) {
        started.insert({append->event.attempt_started().task_key(), append->event.attempt_started().attempt()});
      }
      if (append->event.has_task_committed()) committed.insert(append->event.task_committed().task_key());
    } else if (const auto* dispatch = std::get_if<DispatchEffect>(&effect)) {
      EXPECT_EQ(started.count({dispatch->task.key(), dispatch->attempt}), 1U);
      ++checked;
    } else if (const auto* ack = std::get_if<AckEffect>(&effect)) {
      EXPECT_EQ(committed.count(ack->attempt.task_key), 1U);
      ++checked;
    }
  }
  EXPECT_EQ(checked, 3);
}

TEST(SchedulerTest, TakesALeaseBackWhenItsTimeIsOverAndTellsTheHolder) {
  Bench bench;
  bench.Hello("w1");
  const DispatchEffect first = OnlyDispatch(bench.Submit("job"));
  bench.Hello("w2");
  EXPECT_THAT(bench.Wait(bench.options.lease_ms - 1), IsEmpty());
  const std::vector<Effect> effects = bench.Wait(1);
  const auto cancels = Only<CancelTaskEffect>(effects);
  ASSERT_THAT(cancels, SizeIs(1));
  EXPECT_EQ(cancels[0].worker_id, "w1");
  EXPECT_EQ(cancels[0].attempt, AttemptOf(first));
  const DispatchEffect second = OnlyDispatch(effects);
  EXPECT_EQ(second.worker_id, "w2");
  EXPECT_EQ(second.attempt, first.attempt + 1);
  EXPECT_EQ(bench.Status("job").retries(), 1U);
}

TEST(SchedulerTest, RenewsALeaseWithProgressOfExactlyItsAttempt) {
  Bench bench;
  bench.Hello("w1");
  const DispatchEffect first = OnlyDispatch(bench.Submit("job"));
  const TimeMs most = bench.options.lease_ms - 1;
  bench.Wait(most);
  EXPECT_THAT(bench.Progress(first), IsEmpty());
  EXPECT_THAT(bench.Wait(most), IsEmpty()) << "the lease was renewed";
  bench.Hello("w2");
  const DispatchEffect second = OnlyDispatch(bench.Wait(1));
  ASSERT_EQ(second.worker_id, "w2");
  // The old holder goes on reporting: that must not keep the new lease alive, and it is told again to stop.
  bench.Wait(most);
  EXPECT_THAT(Only<CancelTaskEffect>(bench.Progress(first)), SizeIs(1));
  EXPECT_THAT(Only<CancelTaskEffect>(bench.Wait(1)), SizeIs(1)) << "the second lease ended in spite of the first holder's progress";
}

TEST(SchedulerTest, FencesOffResultsOfOlderAttemptsButAcknowledgesThem) {
  Bench bench;
  bench.Hello("w1");
  const DispatchEffect first = OnlyDispatch(bench.Submit("job"));
  bench.Hello("w2");
  const DispatchEffect second = OnlyDispatch(bench.Wait(bench.options.lease_ms));
  const std::vector<Effect> late = bench.Done(first);
  EXPECT_THAT(Only<AckEffect>(late), SizeIs(1));
  EXPECT_THAT(Only<AppendEffect>(late), IsEmpty()) << "an old attempt's result was taken";
  EXPECT_THAT(Only<AppendEffect>(bench.Fail(first, StatusCode::kInvalidInput, "late")), IsEmpty());
  EXPECT_EQ(bench.Status("job").state(), v1::JOB_RUNNING);
  EXPECT_EQ(bench.scheduler.FindResult(second.task.key()), nullptr);
  bench.Done(second);
  EXPECT_NE(bench.scheduler.FindResult(second.task.key()), nullptr);
}

TEST(SchedulerTest, AcknowledgesWhatItDoesNotKnow) {
  Bench bench;
  bench.Hello("w1");
  TaskDoneEvent event;
  event.worker_id = "w1";
  event.attempt = {"unknown", 3};
  const auto effects = bench.Step(event);
  ASSERT_THAT(effects, SizeIs(1));
  EXPECT_EQ(Only<AckEffect>(effects).at(0).attempt, event.attempt);
}

TEST(SchedulerTest, GivesALostWorkersTaskToAnother) {
  Bench bench;
  bench.Hello("w1");
  const DispatchEffect first = OnlyDispatch(bench.Submit("job"));
  bench.Hello("w2");
  const DispatchEffect second = OnlyDispatch(bench.Step(WorkerLostEvent{"w1"}));
  EXPECT_EQ(second.worker_id, "w2");
  EXPECT_EQ(second.attempt, first.attempt + 1);
  EXPECT_EQ(bench.Status("job").worker_count(), 1U);
}

TEST(SchedulerTest, FailsAJobWhoseTaskIsLostAgainAndAgain) {
  Bench bench;
  bench.Submit("job");
  for (std::uint32_t i = 1; i <= bench.options.losses_max; ++i) {
    EXPECT_EQ(bench.Status("job").state(), v1::JOB_RUNNING) << "after " << i - 1 << " losses";
    EXPECT_EQ(OnlyDispatch(bench.Hello("w1")).attempt, i);
    bench.Step(WorkerLostEvent{"w1"});
  }
  const v1::JobStatus status = bench.Status("job");
  EXPECT_EQ(status.state(), v1::JOB_FAILED);
  EXPECT_EQ(status.error_code(), static_cast<std::uint32_t>(StatusCode::kUnavailable));
  EXPECT_THAT(status.error(), HasSubstr("INGEST: was handed out 10 times"));
}

TEST(SchedulerTest, FailsAJobWhenAllTasksOfAStageAreLost) {
  Bench bench;
  bench.options.losses_max = 1;
  bench.scheduler = Scheduler(bench.options);
  bench.Hello("w1", {}, 16);
  EXPECT_THAT(Only<DispatchEffect>(bench.Done(OnlyDispatch(bench.Submit("job")))), SizeIs(kFakeWindowCount));
  bench.Step(WorkerLostEvent{"w1"});
  EXPECT_EQ(bench.Status("job").state(), v1::JOB_FAILED);
  EXPECT_FALSE(bench.scheduler.has_running());
  bench.Hello("w2");
  EXPECT_THAT(bench.RunAll(bench.Submit("next", "other")), SizeIs(kFakeTaskCount));
}

TEST(SchedulerTest, DoesNotCountAgainstATaskThatItsWorkerLeft) {
  Bench bench;
  bench.Submit("job");
  for (std::uint32_t i = 0; i < 3 * bench.options.losses_max; ++i) {
    OnlyDispatch(bench.Hello("w1"));
    bench.Step(WorkerGoodbyeEvent{"w1"});
  }
  EXPECT_EQ(bench.Status("job").state(), v1::JOB_RUNNING);
}

TEST(SchedulerTest, RetriesFailuresAfterADelayThatGrowsByTheirClassAndThenGivesUp) {
  const SchedulerOptions options;
  struct Class {
    StatusCode code;
    std::uint32_t delay_ms;
    std::uint32_t tries;
  };
  for (const auto& [code, delay_ms, tries] : {Class{StatusCode::kUnavailable, options.retry_delay_ms, options.outages_max},
                                              Class{StatusCode::kExhausted, options.exhausted_delay_ms, options.outages_max},
                                              Class{StatusCode::kCorrupt, options.retry_delay_ms, options.failures_max},
                                              Class{StatusCode::kFailed, options.retry_delay_ms, options.failures_max}}) {
    SCOPED_TRACE(ToString(code));
    Bench bench;
    bench.Hello("w1");
    DispatchEffect dispatch = OnlyDispatch(bench.Submit("job"));
    for (std::uint32_t i = 1; i < tries; ++i) {
      EXPECT_EQ(dispatch.attempt, i);
      EXPECT_THAT(Only<DispatchEffect>(bench.Fail(dispatch, code, "no room in /x")), IsEmpty());
      const TimeMs wait_ms = std::min<TimeMs>(static_cast<TimeMs>(delay_ms) << (i - 1), options.retry_delay_ms_max);
      EXPECT_THAT(Only<DispatchEffect>(bench.Wait(wait_ms - 1)), IsEmpty());
      EXPECT_EQ(bench.Status("job").state(), v1::JOB_RUNNING);
      dispatch = OnlyDispatch(bench.Wait(1));
    }
    bench.Fail(dispatch, code, "no room in /x");
    const v1::JobStatus status = bench.Status("job");
    EXPECT_EQ(status.state(), v1::JOB_FAILED);
    EXPECT_EQ(status.error_code(), static_cast<std::uint32_t>(code));
    EXPECT_THAT(status.error(), HasSubstr("no room in /x (after " + std::to_string(tries) + " attempts)"));
  }
}

TEST(SchedulerTest, CountsADuplicatedFailureOnce) {
  Bench bench;
  bench.Hello("w1");
  const DispatchEffect dispatch = OnlyDispatch(bench.Submit("job"));
  for (int i = 0; i < 5; ++i) bench.Fail(dispatch, StatusCode::kUnavailable, "mount gone");
  EXPECT_EQ(bench.Status("job").state(), v1::JOB_RUNNING);
  EXPECT_EQ(bench.Status("job").retries(), 1U);
}

TEST(SchedulerTest, FailsAtOnceWhereARetryCannotHelp) {
  for (const StatusCode code : {StatusCode::kInvalidInput, StatusCode::kNotFound}) {
    SCOPED_TRACE(ToString(code));
    Bench bench;
    bench.Hello("w1");
    const auto effects = bench.Fail(OnlyDispatch(bench.Submit("job")), code, "/x/a.png is not an image");
    EXPECT_THAT(Only<JobChangedEffect>(effects), SizeIs(1));
    const v1::JobStatus status = bench.Status("job");
    EXPECT_EQ(status.state(), v1::JOB_FAILED);
    EXPECT_EQ(status.error(), "/x/a.png is not an image");
    EXPECT_EQ(status.error_code(), static_cast<std::uint32_t>(code));
    EXPECT_THAT(Only<DispatchEffect>(bench.Wait(100'000)), IsEmpty());
  }
}

TEST(SchedulerTest, FailsAJobThatCannotBePlannedWithThePlannersMessage) {
  Bench bench;
  bench.Hello("w1");
  const DispatchEffect ingest = OnlyDispatch(bench.Submit("job"));
  TaskDoneEvent event{"w1", AttemptOf(ingest), StatusCode::kOk, "", FakeResult(ingest.task), 1, 1, {}};
  event.result.mutable_ingest()->clear_spans();
  bench.Step(event);
  EXPECT_EQ(bench.Status("job").state(), v1::JOB_FAILED);
  EXPECT_THAT(bench.Status("job").error(), HasSubstr("no usable frame"));
}

TEST(SchedulerTest, FailsATaskWhoseResultLacksWhatFollowsNeed) {
  Bench bench;
  bench.Hello("w1");
  DispatchEffect ingest = OnlyDispatch(bench.Submit("job"));
  for (std::uint32_t i = 1; i <= bench.options.failures_max; ++i) {
    EXPECT_EQ(bench.Status("job").state(), v1::JOB_RUNNING) << "a broken worker is not the job's fault yet";
    bench.Step(TaskDoneEvent{"w1", AttemptOf(ingest), StatusCode::kOk, "", {}, 1, 1, {}});
    const auto again = Only<DispatchEffect>(bench.Wait(bench.options.retry_delay_ms_max));
    if (!again.empty()) ingest = again[0];
  }
  EXPECT_EQ(bench.Status("job").state(), v1::JOB_FAILED);
  EXPECT_THAT(bench.Status("job").error(), HasSubstr("has no outputs"));
}

TEST(SchedulerTest, ReportsASecondResultWithOtherBytesAndKeepsTheFirst) {
  Bench bench;
  bench.Hello("w1");
  const DispatchEffect ingest = OnlyDispatch(bench.Submit("job"));
  bench.Done(ingest);
  const auto same = bench.Done(ingest);
  ASSERT_THAT(same, SizeIs(1)) << "the same result again is just acknowledged";
  EXPECT_THAT(Only<AckEffect>(same), SizeIs(1));

  TaskDoneEvent event{"w1", AttemptOf(ingest), StatusCode::kOk, "", FakeResult(ingest.task, "other bytes"), 1, 1, {}};
  const auto other = bench.Step(event);
  EXPECT_THAT(Only<AckEffect>(other), SizeIs(1));
  EXPECT_THAT(Only<JobChangedEffect>(other), SizeIs(1));
  const v1::JobStatus status = bench.Status("job");
  ASSERT_THAT(status.notes(), SizeIs(1));
  EXPECT_EQ(status.notes(0).code(), "result_differs");
  EXPECT_EQ(bench.scheduler.FindResult(ingest.task.key())->outputs(0).sha256(), FakeResult(ingest.task).outputs(0).sha256());
  bench.Restart();
  EXPECT_THAT(bench.Status("job").notes(), SizeIs(1)) << "a report must survive a restart";
}

TEST(SchedulerTest, SharesTasksAndResultsBetweenJobsThatNeedTheSame) {
  Bench bench;
  bench.Hello("w1", {}, 16);
  const DispatchEffect ingest_a = OnlyDispatch(bench.Submit("a"));
  const DispatchEffect ingest_b = OnlyDispatch(bench.Submit("b"));
  EXPECT_NE(ingest_a.task.key(), ingest_b.task.key()) << "a source is read anew for every job";
  const auto enhances = Only<DispatchEffect>(bench.Done(ingest_a));
  EXPECT_THAT(enhances, SizeIs(kFakeWindowCount));
  EXPECT_THAT(Only<DispatchEffect>(bench.Done(ingest_b)), IsEmpty()) << "b waits for the tasks that a has out";
  std::size_t dispatched = 0;
  for (const DispatchEffect& enhance : enhances) dispatched += bench.RunAll(bench.Done(enhance)).size();
  EXPECT_EQ(dispatched, 1 + kFakeTileCount + 1);
  EXPECT_EQ(bench.Status("a").state(), v1::JOB_DONE);
  EXPECT_EQ(bench.Status("b").state(), v1::JOB_DONE);
  EXPECT_EQ(bench.Status("a").outputs(0).sha256(), bench.Status("b").outputs(0).sha256());
  // And a third one, later, has only its source to read.
  EXPECT_THAT(bench.RunAll(bench.Submit("c")), SizeIs(1));
  EXPECT_EQ(bench.Status("c").state(), v1::JOB_DONE);
}

TEST(SchedulerTest, TakesBackTheTasksOfACancelledJobUnlessAnotherWantsThem) {
  Bench bench;
  bench.Hello("w1", {}, 16);
  const DispatchEffect ingest_a = OnlyDispatch(bench.Submit("a"));
  const DispatchEffect ingest_b = OnlyDispatch(bench.Submit("b"));
  bench.Done(ingest_a);
  bench.Done(ingest_b);
  const auto cancel_a = bench.Step(CancelJobEvent{"a"});
  EXPECT_THAT(Only<CancelTaskEffect>(cancel_a), IsEmpty()) << "b still wants them";
  EXPECT_EQ(bench.Status("a").state(), v1::JOB_CANCELLED);
  EXPECT_EQ(bench.Status("b").state(), v1::JOB_RUNNING);
  EXPECT_THAT(Only<CancelTaskEffect>(bench.Step(CancelJobEvent{"b"})), SizeIs(kFakeWindowCount));
  EXPECT_FALSE(bench.scheduler.has_running());
  EXPECT_THAT(bench.Step(CancelJobEvent{"b"}), IsEmpty()) << "cancelling twice is nothing";
}

TEST(SchedulerTest, KeepsASharedTaskInTheQueuePlaceOfTheJobThatStillWantsIt) {
  Bench bench;
  bench.Submit("a");
  bench.Submit("b");
  bench.Submit("c", "other");
  bench.Hello("w1", {}, 3);
  // All three sources are read; the enhance tasks of a and b are the same and wait.
  const v1::Sortie sortie = FakeSortie("leg");
  std::vector<DispatchEffect> ingests;
  for (const char* job : {"a", "b", "c"}) {
    JobInputs inputs;
    inputs.job_id = job;
    inputs.sortie = std::string(job) == "c" ? FakeSortie("other") : sortie;
    ingests.push_back({"w1", PlanTask(inputs, v1::INGEST, 0), 1, 0});
  }
  bench.Step(WorkerGoodbyeEvent{"w1"});
  for (const DispatchEffect& ingest : ingests) bench.Done(ingest);
  bench.Step(CancelJobEvent{"a"});
  const DispatchEffect next = OnlyDispatch(bench.Hello("w2"));
  EXPECT_EQ(TitleOf(next), "ENHANCE window 0");
  EXPECT_EQ(FakeSortieNameOf(next.task), "leg") << "b was submitted before c";
}

TEST(SchedulerTest, TakesAFailedJobUpAgainWhenItIsSubmittedAgainAndReusesWhatIsDone) {
  Bench bench;
  bench.Hello("w1", {}, 8);
  for (const DispatchEffect& enhance : Only<DispatchEffect>(bench.Done(OnlyDispatch(bench.Submit("job"))))) {
    bench.Fail(enhance, StatusCode::kInvalidInput, "singular");
  }
  ASSERT_EQ(bench.Status("job").state(), v1::JOB_FAILED);
  const auto again = bench.RunAll(bench.Submit("job"));
  ASSERT_FALSE(again.empty());
  for (const DispatchEffect& dispatch : again) EXPECT_NE(TitleOf(dispatch), "INGEST") << "the source need not be read again";
  EXPECT_EQ(bench.Status("job").state(), v1::JOB_DONE);
}

TEST(SchedulerTest, TakesACancelledJobUpAgainWhenItIsSubmittedAgainAndReusesWhatIsDone) {
  Bench bench;
  bench.Hello("w1");
  const DispatchEffect enhance = OnlyDispatch(bench.Done(OnlyDispatch(bench.Submit("job"))));
  bench.Step(CancelJobEvent{"job"});
  bench.Fail(enhance, StatusCode::kCancelled, "as asked");
  const auto again = bench.RunAll(bench.Submit("job"));
  ASSERT_FALSE(again.empty());
  EXPECT_EQ(Titles(again).front(), "ENHANCE window 0") << "the source need not be read again";
  EXPECT_EQ(again.front().attempt, 2U);
  EXPECT_EQ(bench.Status("job").state(), v1::JOB_DONE);
  EXPECT_THAT(bench.Submit("job"), IsEmpty()) << "a job that is done stays done";
}

TEST(SchedulerTest, GivesNothingNewToAWorkerThatDoesNotLetGo) {
  Bench bench;
  bench.Hello("w1");
  const DispatchEffect first = OnlyDispatch(bench.Submit("job"));
  EXPECT_THAT(Only<DispatchEffect>(bench.Wait(bench.options.lease_ms)), IsEmpty()) << "w1 hangs; its slot is not free";
  bench.Wait(bench.options.lease_ms - 1);
  EXPECT_THAT(Only<DispatchEffect>(bench.Progress(first)), IsEmpty()) << "it still works on the old attempt";
  EXPECT_THAT(Only<DispatchEffect>(bench.Wait(bench.options.lease_ms - 1)), IsEmpty());
  EXPECT_EQ(OnlyDispatch(bench.Wait(1)).attempt, 2U) << "silent about it for a whole lease: it never got it or has forgotten it";
}

TEST(SchedulerTest, FreesTheSlotWhenARevokedAttemptReportsDone) {
  Bench bench;
  bench.Hello("w1");
  const DispatchEffect first = OnlyDispatch(bench.Submit("job"));
  bench.Wait(bench.options.lease_ms);
  // It is still the newest attempt, so its late result is as good as any.
  EXPECT_EQ(TitleOf(OnlyDispatch(bench.Done(first))), "ENHANCE window 0");
}

TEST(SchedulerTest, TellsProgressAndTimeLeft) {
  Bench bench;
  bench.Hello("w1");
  double fraction_before = -1.0;
  DispatchEffect dispatch = OnlyDispatch(bench.Submit("job"));
  EXPECT_LT(bench.Status("job").eta_s(), 0.0);
  for (std::uint32_t i = 0; i < kFakeTaskCount; ++i) {
    bench.Progress(dispatch, 0.5);
    bench.Progress(dispatch, 0.2);  // Of a part that runs beside another: nothing is undone.
    const v1::JobStatus status = bench.Status("job");
    const v1::StageStatus& stage = status.stages(dispatch.task.kind() - 1);
    EXPECT_EQ(stage.running(), 1U);
    EXPECT_EQ(stage.running_fraction(), 0.5);
    EXPECT_GT(status.fraction(), fraction_before);
    EXPECT_LT(status.fraction(), 1.0);
    EXPECT_EQ(status.eta_s() < 0.0, i <= 1) << "known once an enhance task is done";
    fraction_before = status.fraction();
    const auto next = Only<DispatchEffect>(bench.Done(dispatch));
    if (!next.empty()) dispatch = next[0];
  }
  const v1::JobStatus status = bench.Status("job");
  EXPECT_EQ(status.eta_s(), 0.0);
  EXPECT_EQ(status.stages(v1::ENHANCE - 1).total(), kFakeWindowCount);
  EXPECT_EQ(status.stages(v1::ENHANCE - 1).done(), kFakeWindowCount);
}

TEST(SchedulerTest, MergesNotesSortedAndUnique) {
  Bench bench;
  bench.Hello("w1");
  DispatchEffect dispatch = OnlyDispatch(bench.Submit("job"));
  for (const char* subject : {"b", "a", "b"}) {
    TaskDoneEvent event{"w1", AttemptOf(dispatch), StatusCode::kOk, "", FakeResult(dispatch.task), 1, 1, {}};
    event.result.add_notes()->set_subject(subject);
    dispatch = OnlyDispatch(bench.Step(event));
  }
  const v1::JobStatus status = bench.Status("job");
  ASSERT_THAT(status.notes(), SizeIs(2));
  EXPECT_EQ(status.notes(0).subject(), "a");
  EXPECT_EQ(status.notes(1).subject(), "b");
}

}  // namespace
}  // namespace trem::testing
