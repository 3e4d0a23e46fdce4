// Goal: a coordinator that was killed goes on where its log ends, and a worker that comes back keeps or gives up exactly what it should.
// Method: the scheduler is thrown away and rebuilt from the events it asked to be made durable; workers say Hello again.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <iterator>
#include <set>

#include "coordinator/scheduling/scheduler.h"
#include "tests/unit/coordinator/scheduling/fake_tasks.h"

namespace trem::testing {
namespace {

using ::testing::_;
using ::testing::Each;
using ::testing::IsEmpty;
using ::testing::SizeIs;
using ::testing::VariantWith;

DispatchEffect OnlyDispatch(const std::vector<Effect>& effects) {
  const auto dispatches = Only<DispatchEffect>(effects);
  TREM_CHECK_MSG(dispatches.size() == 1, std::to_string(dispatches.size()) + " dispatches");
  return dispatches[0];
}

TEST(RecoveryTest, RebuildsTheSameStateFromTheLogAtEveryPointOfAJob) {
  Bench bench;
  bench.Hello("w1");
  DispatchEffect dispatch = OnlyDispatch(bench.Submit("job"));
  for (std::uint32_t done = 1; done <= kFakeTaskCount; ++done) {
    const auto next = Only<DispatchEffect>(bench.Done(dispatch));
    const v1::JobStatus before = bench.Status("job");
    bench.Restart();
    const v1::JobStatus after = bench.Status("job");
    EXPECT_EQ(after.state(), before.state());
    for (int i = 0; i < before.stages_size(); ++i) {
      EXPECT_EQ(after.stages(i).done(), before.stages(i).done());
      EXPECT_EQ(after.stages(i).total(), before.stages(i).total());
    }
    EXPECT_EQ(after.outputs_size(), before.outputs_size());
    EXPECT_EQ(after.peak_memory_bytes(), before.peak_memory_bytes());
    if (next.empty()) break;
    dispatch = next[0];
    EXPECT_THAT(bench.Hello("w1", {AttemptOf(dispatch)}), IsEmpty()) << "the worker goes on with what it has";
  }
  EXPECT_EQ(bench.Status("job").state(), v1::JOB_DONE);
}

TEST(RecoveryTest, NeverHandsOutTheSameAttemptTwice) {
  Bench bench;
  std::uint32_t last = 0;
  bench.Submit("job");
  for (int i = 0; i < 10; ++i) {
    const DispatchEffect dispatch = i == 0 ? OnlyDispatch(bench.Hello("w")) : OnlyDispatch(bench.Wait(bench.options.restart_grace_ms));
    EXPECT_GT(dispatch.attempt, last);
    last = dispatch.attempt;
    bench.Restart();
    bench.Hello("w" + std::to_string(i));
  }
}

TEST(RecoveryTest, WaitsAWhileForTheWorkerThatHeldATaskBeforeTheRestart) {
  Bench bench;
  bench.Hello("w1");
  const DispatchEffect first = OnlyDispatch(bench.Submit("job"));
  bench.Restart();
  EXPECT_THAT(Only<DispatchEffect>(bench.Hello("w2")), IsEmpty()) << "w1 may come back with it";
  EXPECT_THAT(Only<DispatchEffect>(bench.Wait(bench.options.restart_grace_ms - 1)), IsEmpty());
  EXPECT_THAT(bench.Hello("w1", {AttemptOf(first)}), Each(VariantWith<ShareEffect>(_))) << "nothing but that w2 lends its processor";
  EXPECT_THAT(Only<DispatchEffect>(bench.Wait(bench.options.restart_grace_ms)), IsEmpty()) << "w1 has a full lease now";
  EXPECT_THAT(Only<AppendEffect>(bench.Done(first)), SizeIs(1 + 2)) << "its result is committed and two tasks follow";
}

TEST(RecoveryTest, HandsATaskToAnotherWhenItsWorkerDoesNotComeBack) {
  Bench bench;
  bench.Hello("w1");
  const DispatchEffect first = OnlyDispatch(bench.Submit("job"));
  bench.Restart();
  bench.Hello("w2");
  const DispatchEffect second = OnlyDispatch(bench.Wait(bench.options.restart_grace_ms));
  EXPECT_EQ(second.attempt, first.attempt + 1);
  const auto late = bench.Hello("w1", {AttemptOf(first)});
  ASSERT_THAT(Only<CancelTaskEffect>(late), SizeIs(1)) << "the task has moved on";
  EXPECT_EQ(Only<CancelTaskEffect>(late)[0].attempt, AttemptOf(first));
}

TEST(RecoveryTest, TakesAResultThatWasKeptWhileTheCoordinatorWasAway) {
  Bench bench;
  bench.Hello("w1");
  const DispatchEffect first = OnlyDispatch(bench.Submit("job"));
  bench.Restart();
  bench.Hello("w1", {AttemptOf(first)});
  EXPECT_THAT(Only<DispatchEffect>(bench.Done(first)), SizeIs(1));
  EXPECT_EQ(bench.Status("job").stages(0).done(), 1U);
}

TEST(RecoveryTest, CancelsWhatAWorkerRunsForAJobThatHasEnded) {
  Bench bench;
  bench.Hello("w1");
  const DispatchEffect first = OnlyDispatch(bench.Submit("job"));
  bench.Step(CancelJobEvent{"job"});
  bench.Restart();
  EXPECT_EQ(bench.Status("job").state(), v1::JOB_CANCELLED);
  EXPECT_THAT(Only<CancelTaskEffect>(bench.Hello("w1", {AttemptOf(first)})), SizeIs(1));
}

TEST(RecoveryTest, RemembersWhyAJobFailed) {
  Bench bench;
  bench.Hello("w1");
  bench.Fail(OnlyDispatch(bench.Submit("job")), StatusCode::kNotFound, "/data/leg does not exist");
  bench.Restart();
  EXPECT_EQ(bench.Status("job").state(), v1::JOB_FAILED);
  EXPECT_EQ(bench.Status("job").error(), "/data/leg does not exist");
  EXPECT_EQ(bench.Status("job").error_code(), static_cast<std::uint32_t>(StatusCode::kNotFound));
}

TEST(RecoveryTest, RunsATaskAgainWhoseArtefactsAreGoneAndReusesTheRest) {
  Bench bench;
  bench.Hello("w1");
  const auto done = bench.RunAll(bench.Submit("job"));
  ASSERT_EQ(bench.Status("job").state(), v1::JOB_DONE);
  const std::string lost_key = done[2].task.key();
  bench.Restart({lost_key});
  EXPECT_EQ(bench.Status("job").state(), v1::JOB_RUNNING);
  bench.Hello("w1");
  const auto again = bench.RunAll(bench.Wait(bench.options.restart_grace_ms));
  ASSERT_THAT(again, SizeIs(1));
  EXPECT_EQ(again[0].task.key(), lost_key);
  EXPECT_EQ(again[0].attempt, 2U);
  EXPECT_EQ(bench.Status("job").state(), v1::JOB_DONE);
}

std::set<std::string> ArtefactsInUse(const Scheduler& scheduler) {
  std::set<std::string> digests;
  scheduler.VisitInUse([&](const v1::ArtefactRef& artefact) { digests.insert(artefact.sha256()); }, [](const v1::Sortie&) {});
  return digests;
}

TEST(RecoveryTest, ARemovedJobIsForgottenWithWhatOnlyItHad) {
  Bench bench;
  bench.Hello("w1");
  for (const char* job : {"a", "b"}) bench.RunAll(bench.Submit(job));
  const std::set<std::string> shared = ArtefactsInUse(bench.scheduler);
  const auto others = bench.RunAll(bench.Submit("c", "other"));
  const std::set<std::string> all = ArtefactsInUse(bench.scheduler);
  ASSERT_GT(shared.size(), 2U);
  ASSERT_GT(all.size(), shared.size());
  for (const bool restarts : {false, true}) {
    SCOPED_TRACE(restarts);
    bench.Step(RemoveJobEvent{"a"});
    if (restarts) bench.Restart();
    EXPECT_FALSE(bench.scheduler.JobStatus("a").has_value());
    EXPECT_EQ(bench.Status("b").state(), v1::JOB_DONE);
    EXPECT_EQ(ArtefactsInUse(bench.scheduler), all) << "b and c have them";
    bench.Step(RemoveJobEvent{"b"});
    if (restarts) bench.Restart();
    std::set<std::string> left;
    std::set_difference(all.begin(), all.end(), shared.begin(), shared.end(), std::inserter(left, left.end()));
    EXPECT_EQ(ArtefactsInUse(bench.scheduler), left);
    EXPECT_EQ(bench.Status("c").state(), v1::JOB_DONE);
    // Made anew, under new numbers.
    bench.Hello("w1");
    const auto again = bench.RunAll(bench.Submit("a"));
    EXPECT_EQ(again.size(), others.size());
    for (const DispatchEffect& dispatch : again) EXPECT_GE(dispatch.attempt, 2U);
    bench.RunAll(bench.Submit("b"));
    EXPECT_EQ(ArtefactsInUse(bench.scheduler), all);
  }
}

// Its artefacts are gone by then, so that its tasks are left out when the log is read.
TEST(RecoveryTest, ARemovedJobStaysForgottenThoughTheLogStillTellsOfIt) {
  Bench bench;
  bench.Hello("w1");
  const auto done = bench.RunAll(bench.Submit("job"));
  bench.RunAll(bench.Submit("kept", "other"));
  bench.Step(RemoveJobEvent{"job"});
  std::vector<std::string> gone;
  for (const DispatchEffect& dispatch : done) gone.push_back(dispatch.task.key());
  bench.Restart(gone);
  EXPECT_FALSE(bench.scheduler.JobStatus("job").has_value());
  EXPECT_EQ(bench.Status("kept").state(), v1::JOB_DONE);
  EXPECT_THAT(Only<DispatchEffect>(bench.Hello("w1")), IsEmpty());
  EXPECT_THAT(Only<DispatchEffect>(bench.Wait(bench.options.restart_grace_ms)), IsEmpty());
}

// A job that wants other tiles of the same windows; what it had made again is not its own.
TEST(RecoveryTest, WhatAFinishedJobHasStaysItsOwnWhenAnotherHadItMadeAgain) {
  for (const bool ends_unrepaired : {false, true}) {
    SCOPED_TRACE(ends_unrepaired);
    Bench bench;
    bench.Hello("w1");
    bench.RunAll(bench.Submit("done"));
    const std::set<std::string> had = ArtefactsInUse(bench.scheduler);
    v1::Sortie other = FakeSortie("leg");
    other.mutable_mosaic()->set_gsd(0.25);
    DispatchEffect dispatch = Only<DispatchEffect>(bench.Step(SubmitJobEvent{"other", other, "", 0})).at(0);
    while (dispatch.task.kind() != v1::ALIGN) dispatch = Only<DispatchEffect>(bench.Done(dispatch)).at(0);
    const auto repairs = Only<DispatchEffect>(bench.Fail(dispatch, StatusCode::kCorrupt, "damaged", {dispatch.task.inputs(2).sha256()}));
    ASSERT_EQ(repairs.size(), 1U);
    ASSERT_EQ(repairs[0].task.kind(), v1::ENHANCE);
    bench.RestartFromSnapshot();
    EXPECT_EQ(bench.Status("done").state(), v1::JOB_DONE);
    bench.Hello("w1", {AttemptOf(repairs[0])});
    if (!ends_unrepaired) bench.Done(repairs[0]);
    bench.Step(CancelJobEvent{"other"});
    bench.Step(RemoveJobEvent{"other"});
    EXPECT_EQ(ArtefactsInUse(bench.scheduler), had);
    bench.RestartFromSnapshot();
    EXPECT_EQ(ArtefactsInUse(bench.scheduler), had);
    EXPECT_EQ(bench.Status("done").state(), v1::JOB_DONE);
  }
}

TEST(RecoveryTest, ARunningJobIsNotRemoved) {
  Bench bench;
  bench.Hello("w1");
  bench.Submit("job");
  EXPECT_THAT(bench.Step(RemoveJobEvent{"job"}), IsEmpty());
  EXPECT_EQ(bench.Status("job").state(), v1::JOB_RUNNING);
  bench.Step(CancelJobEvent{"job"});
  bench.Step(RemoveJobEvent{"job"});
  EXPECT_FALSE(bench.scheduler.JobStatus("job").has_value());
  EXPECT_THAT(bench.Step(RemoveJobEvent{"job"}), IsEmpty()) << "removing twice is nothing";
}

TEST(RecoveryTest, TakesBackWhatAWorkerThatReconnectedDoesNotName) {
  Bench bench;
  bench.Hello("w1");
  const DispatchEffect first = OnlyDispatch(bench.Submit("job"));
  const auto effects = bench.Hello("w1");
  EXPECT_THAT(Only<CancelTaskEffect>(effects), SizeIs(1));
  EXPECT_EQ(OnlyDispatch(effects).attempt, first.attempt + 1) << "its Dispatch was lost with the connection";
}

TEST(RecoveryTest, KeepsTheLeaseOfAWorkerThatReconnectedAndNamesIt) {
  Bench bench;
  bench.Hello("w1");
  const DispatchEffect first = OnlyDispatch(bench.Submit("job"));
  EXPECT_THAT(bench.Hello("w1", {AttemptOf(first)}), IsEmpty());
  EXPECT_THAT(Only<DispatchEffect>(bench.Done(first)), SizeIs(1));
}

TEST(RecoveryTest, AProgressOfAnOldAttemptDoesNotTouchTheNewOneOnTheSameWorker) {
  Bench bench;
  bench.Hello("w1");
  const DispatchEffect first = OnlyDispatch(bench.Submit("job"));
  const DispatchEffect second = OnlyDispatch(bench.Hello("w1"));
  ASSERT_EQ(second.attempt, 2U);
  EXPECT_THAT(Only<CancelTaskEffect>(bench.Progress(first)), SizeIs(1));
  EXPECT_EQ(bench.Status("job").stages(0).running(), 1U);
  EXPECT_THAT(Only<DispatchEffect>(bench.Done(second)), SizeIs(1));
}

TEST(RecoveryTest, RefusesALogThatMakesNoSense) {
  Scheduler scheduler;
  v1::LogEvent event;
  event.mutable_job_cancelled()->set_job_id("never-submitted");
  EXPECT_EQ(scheduler.Restore(event).code(), StatusCode::kCorrupt);
  EXPECT_EQ(scheduler.Restore(v1::LogEvent()).code(), StatusCode::kCorrupt);

  Bench bench;
  bench.Hello("w1");
  const DispatchEffect ingest = Only<DispatchEffect>(bench.Submit("job")).at(0);
  for (const v1::LogEvent& logged : bench.log) ASSERT_TRUE(scheduler.Restore(logged).ok());
  event.mutable_task_quarantined()->set_job_id("job");
  event.mutable_task_quarantined()->set_task_key(ingest.task.key());
  event.mutable_task_quarantined()->set_status_code(static_cast<std::uint32_t>(StatusCode::kFailed));
  EXPECT_EQ(scheduler.Restore(event).code(), StatusCode::kCorrupt) << "nothing can be made without an INGEST";
}

}  // namespace
}  // namespace trem::testing
