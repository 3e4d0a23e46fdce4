// Goal: the rules of the scheduler about whose task goes where, what becomes of tasks that fail, and what is done about stragglers and
// damage; one test each. Method: as scheduler_test.cc.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "coordinator/scheduling/scheduler.h"
#include "tests/unit/coordinator/scheduling/fake_tasks.h"

namespace trem::testing {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

DispatchEffect OnlyDispatch(const std::vector<Effect>& effects) {
  const auto dispatches = Only<DispatchEffect>(effects);
  TREM_CHECK_MSG(dispatches.size() == 1, std::to_string(dispatches.size()) + " dispatches");
  return dispatches[0];
}

std::string UserOf(const DispatchEffect& dispatch) { return FakeSortieNameOf(dispatch.task); }

// Reads the source of a job with a worker that leaves again: its ENHANCE tasks are ready then.
void Unfold(Bench* bench, const std::string& job_id, const std::string& sortie_name, const std::string& user = "", int priority = 0) {
  bench->Submit(job_id, sortie_name, user, priority);
  JobInputs inputs;
  inputs.job_id = job_id;
  inputs.sortie = FakeSortie(sortie_name);
  const std::string key = PlanTask(inputs, v1::INGEST, 0).key();
  for (const DispatchEffect& dispatch : Only<DispatchEffect>(bench->Hello("unfolder", {}, 1'000))) {
    if (dispatch.task.key() == key) bench->Done(dispatch);
  }
  bench->Step(WorkerGoodbyeEvent{"unfolder"});
}

// ---- Whose task -------------------------------------------------------------------------------------------------------------------

TEST(PolicyTest, ServesAHigherPriorityFirst) {
  Bench bench;
  bench.Submit("low", "low", "ann", -1);
  bench.Submit("mid", "mid", "ann", 0);
  bench.Submit("high", "high", "bob", 10);
  std::vector<std::string> order;
  for (const DispatchEffect& dispatch : bench.RunAll(bench.Hello("w"))) {
    if (order.empty() || order.back() != UserOf(dispatch)) order.push_back(UserOf(dispatch));
  }
  EXPECT_THAT(order, ElementsAre("high", "mid", "low"));
}

TEST(PolicyTest, SharesTheWorkersBetweenUsersHoweverManyJobsEachHas) {
  Bench bench;
  for (const char* job : {"a1", "a2", "a3"}) Unfold(&bench, job, job, "ann");
  Unfold(&bench, "b1", "b1", "bob");
  std::map<char, int> counts;
  for (const DispatchEffect& dispatch : Only<DispatchEffect>(bench.Hello("w", {}, 6))) ++counts[UserOf(dispatch)[0]];
  EXPECT_EQ(counts['a'], 3);
  EXPECT_EQ(counts['b'], 3);
}

TEST(PolicyTest, GivesTheFreeWorkerToTheUserWithTheFewestRunningTasks) {
  Bench bench;
  Unfold(&bench, "a1", "a1", "ann");
  Unfold(&bench, "a2", "a2", "ann");
  const auto anns = Only<DispatchEffect>(bench.Hello("w", {}, 4));
  ASSERT_THAT(anns, SizeIs(4));
  bench.Submit("b", "b", "bob");
  EXPECT_EQ(UserOf(OnlyDispatch(bench.Done(anns[0]))), "b") << "ann has three, bob none";
}

TEST(PolicyTest, KeepsAUserToItsLimitAndGoesOnWhenATaskEnds) {
  Bench bench;
  bench.options.user_tasks_max = 2;
  bench.scheduler = Scheduler(bench.options);
  Unfold(&bench, "a", "a", "ann");
  const auto first = Only<DispatchEffect>(bench.Hello("w", {}, 8));
  ASSERT_THAT(first, SizeIs(2)) << "six workers idle rather than more than two tasks of ann";
  EXPECT_THAT(Only<DispatchEffect>(bench.Done(first[0])), SizeIs(1));
  EXPECT_THAT(Only<DispatchEffect>(bench.Fail(first[1], StatusCode::kUnavailable, "gone")), SizeIs(1));
}

TEST(PolicyTest, MovesASharedTaskToThePlaceOfTheMostUrgentJobThatWantsIt) {
  Bench bench;
  Unfold(&bench, "other", "other", "ann", 1);
  Unfold(&bench, "slow", "leg", "ann", 0);
  bench.Submit("urgent", "leg", "bob", 5);
  const DispatchEffect ingest = OnlyDispatch(bench.Hello("w"));
  EXPECT_EQ(UserOf(ingest), "leg");
  const DispatchEffect next = OnlyDispatch(bench.Done(ingest));
  EXPECT_EQ(TitleOf(next), "ENHANCE window 0");
  EXPECT_EQ(UserOf(next), "leg") << "the window is slow's too, but urgent's comes before other's";
  bench.Step(CancelJobEvent{"urgent"});
  EXPECT_EQ(UserOf(OnlyDispatch(bench.Hello("w2"))), "other") << "what is left of leg is slow's again";
}

TEST(PolicyTest, CountsJobsByUser) {
  Bench bench;
  bench.Submit("a", "a", "ann");
  bench.Submit("b", "b", "ann");
  bench.Submit("c", "c", "bob");
  bench.Step(CancelJobEvent{"b"});
  EXPECT_EQ(bench.scheduler.RunningJobCount("ann"), 1U);
  EXPECT_EQ(bench.scheduler.RunningJobCount("bob"), 1U);
  EXPECT_EQ(bench.scheduler.RunningJobCount("cid"), 0U);
}

// ---- Where to ---------------------------------------------------------------------------------------------------------------------

TEST(PolicyTest, FillsTheTightestMemoryThatHoldsATask) {
  Bench bench;
  const std::uint64_t need = [] {
    Bench other;
    other.Hello("w");
    return OnlyDispatch(other.Submit("job")).task.memory_bytes();
  }();
  bench.Hello("huge", {}, 1, 100 * need);
  bench.Hello("exact", {}, 1, need);
  bench.Hello("small", {}, 1, need - 1);
  EXPECT_EQ(OnlyDispatch(bench.Submit("job")).worker_id, "exact");
}

TEST(PolicyTest, ReservesTheMemoryOfWhatAWorkerRuns) {
  Bench bench;
  bench.Hello("w");
  const auto enhance = OnlyDispatch(bench.Done(OnlyDispatch(bench.Submit("job"))));
  const std::uint64_t need = enhance.task.memory_bytes();
  EXPECT_THAT(Only<DispatchEffect>(bench.Hello("pair", {}, 8, 2 * need + need / 2)), SizeIs(2)) << "room for two, credit for eight";
}

TEST(PolicyTest, LooksPastTasksThatFitNoIdleWorker) {
  Bench bench;
  bench.Hello("w", {}, 4);
  const auto enhances = Only<DispatchEffect>(bench.Done(OnlyDispatch(bench.Submit("job"))));
  bench.Step(WorkerGoodbyeEvent{"w"});
  // INGEST assumes large images and needs more than these windows.
  bench.Submit("first", "other", "", 10);
  EXPECT_EQ(TitleOf(OnlyDispatch(bench.Hello("small", {}, 1, enhances[0].task.memory_bytes()))), "ENHANCE window 0");
}

TEST(PolicyTest, LetsAHostGoOnWithTheFramesThatItHasReadAndBeginsOthersElsewhere) {
  Bench bench;
  Unfold(&bench, "job", "leg");  // Windows 0 and 1 are of the first frames, 2 and 3 of the last.
  bench.Step(CancelJobEvent{"job"});
  bench.Submit("job");
  const DispatchEffect a1 = OnlyDispatch(bench.Hello("a1", {}, 1, 0, "a"));
  EXPECT_EQ(TitleOf(a1), "ENHANCE window 0");
  EXPECT_EQ(TitleOf(OnlyDispatch(bench.Hello("b1", {}, 1, 0, "b"))), "ENHANCE window 2") << "host a reads the first frames already";
  EXPECT_EQ(TitleOf(OnlyDispatch(bench.Hello("b2", {}, 1, 0, "b"))), "ENHANCE window 3");
  EXPECT_EQ(TitleOf(OnlyDispatch(bench.Hello("b3", {}, 1, 0, "b"))), "ENHANCE window 1") << "nothing else is left";
}

// ---- Failures ---------------------------------------------------------------------------------------------------------------------

TEST(PolicyTest, GivesUpAWindowThatFailsThreeTimesOnTwoWorkersAndEndsTheJobInPart) {
  Bench bench;
  bench.Hello("w1");
  std::vector<DispatchEffect> out = Only<DispatchEffect>(bench.Done(OnlyDispatch(bench.Submit("job"))));
  const std::string key = out.at(0).task.key();
  const auto take = [&out](const std::vector<Effect>& effects) {
    for (const DispatchEffect& next : Only<DispatchEffect>(effects)) out.push_back(next);
  };
  take(bench.Hello("w2"));
  take(bench.Hello("w3"));
  std::set<std::string> failed_on;
  int failures = 0;
  for (std::size_t i = 0; bench.Status("job").state() == v1::JOB_RUNNING; ++i) {
    TREM_CHECK(i < 1'000);
    if (i >= out.size()) {
      take(bench.Wait(bench.options.retry_delay_ms));
      --i;
      continue;
    }
    const DispatchEffect now = out[i];
    if (now.task.key() == key) {
      failed_on.insert(now.worker_id);
      ++failures;
      take(bench.Fail(now, StatusCode::kFailed, "singular matrix"));
    } else {
      take(bench.Done(now));
    }
  }
  EXPECT_EQ(failures, 3);
  EXPECT_GE(failed_on.size(), 2U);
  const v1::JobStatus status = bench.Status("job");
  EXPECT_EQ(status.state(), v1::JOB_DONE_IN_PART);
  ASSERT_THAT(status.outputs(), SizeIs(1)) << "the mosaic is made of the others";
  ASSERT_THAT(status.holes(), SizeIs(1));
  EXPECT_EQ(status.holes(0).subject(), "ENHANCE window 0");
  EXPECT_THAT(status.holes(0).message(), HasSubstr("singular matrix"));
  for (const DispatchEffect& dispatch : out) {
    if (dispatch.task.kind() == v1::ALIGN) {
      EXPECT_EQ(dispatch.task.inputs_size(), 1 + static_cast<int>(kFakeWindowCount) - 1);
    } else if (dispatch.task.kind() == v1::EXPORT) {
      EXPECT_THAT(dispatch.task.export_params().holes(), SizeIs(1));
    }
  }
  bench.Restart();
  EXPECT_EQ(bench.Status("job").SerializeAsString(),
            [&] {
              v1::JobStatus expected = status;
              expected.set_worker_count(0);
              expected.set_retries(0);
              return expected;
            }()
                .SerializeAsString())
      << "a restart must not change what has become of a job";
}

TEST(PolicyTest, NamesTheMissingTilesToTheExport) {
  Bench bench;
  bench.Hello("w");
  std::vector<DispatchEffect> out = Only<DispatchEffect>(bench.Submit("job"));
  DispatchEffect last;
  while (!out.empty()) {
    last = out[0];
    const bool bad = TitleOf(last) == "COMPOSITE tile 1";
    out = Only<DispatchEffect>(bad ? bench.Fail(last, StatusCode::kInvalidInput, "no") : bench.Done(last));
  }
  EXPECT_EQ(TitleOf(last), "EXPORT");
  EXPECT_EQ(last.task.inputs_size(), 2 + static_cast<int>(kFakeWindowCount) + 2);
  EXPECT_THAT(last.task.export_params().missing_tiles(), ElementsAre(1U));
  EXPECT_EQ(bench.Status("job").state(), v1::JOB_DONE_IN_PART);
}

TEST(PolicyTest, DoesNotRetryAWindowWhoseInputIsInvalid) {
  Bench bench;
  bench.Hello("w");
  const DispatchEffect enhance = OnlyDispatch(bench.Done(OnlyDispatch(bench.Submit("job"))));
  EXPECT_EQ(bench.FailUntilGivenUp(enhance, StatusCode::kInvalidInput, "bad spec"), 1);
}

TEST(PolicyTest, GivesUpWithOneWorkerAloneAfterThreeTimes) {
  Bench bench;
  bench.Hello("w");
  const DispatchEffect enhance = OnlyDispatch(bench.Done(OnlyDispatch(bench.Submit("job"))));
  bench.Fail(enhance, StatusCode::kFailed, "singular");
  std::uint32_t attempts = 1;
  for (int i = 0; i < 20; ++i) {
    for (const DispatchEffect& dispatch : Only<DispatchEffect>(bench.Wait(bench.options.retry_delay_ms_max))) {
      if (dispatch.task.key() != enhance.task.key()) {
        bench.Done(dispatch);
        continue;
      }
      attempts = dispatch.attempt;
      bench.Fail(dispatch, StatusCode::kFailed, "singular");
    }
  }
  EXPECT_EQ(attempts, bench.options.failures_max);
}

TEST(PolicyTest, FailsAJobOfWhichNothingIsLeftWithTheFirstReason) {
  Bench bench;
  bench.Hello("w", {}, 8);
  const auto enhances = Only<DispatchEffect>(bench.Done(OnlyDispatch(bench.Submit("job"))));
  ASSERT_THAT(enhances, SizeIs(kFakeWindowCount));
  for (std::size_t i = 0; i < enhances.size(); ++i) {
    EXPECT_EQ(bench.Status("job").state(), v1::JOB_RUNNING);
    bench.Fail(enhances[i], StatusCode::kInvalidInput, "reason " + std::to_string(i));
  }
  EXPECT_EQ(bench.Status("job").state(), v1::JOB_FAILED);
  EXPECT_EQ(bench.Status("job").error(), "all 4 ENHANCE tasks failed; the first one: reason 0");
  EXPECT_EQ(bench.Status("job").error_code(), static_cast<std::uint32_t>(StatusCode::kInvalidInput));
}

TEST(PolicyTest, TriesAFailedTaskOnAnotherWorkerWhenOneIsIdle) {
  Bench bench;
  bench.Hello("a");
  const DispatchEffect first = OnlyDispatch(bench.Submit("job"));
  ASSERT_EQ(first.worker_id, "a");
  bench.Hello("b");
  bench.Fail(first, StatusCode::kFailed, "bad memory");
  const DispatchEffect second = OnlyDispatch(bench.Wait(bench.options.retry_delay_ms));
  EXPECT_EQ(second.worker_id, "b");
}

TEST(PolicyTest, WaitsAWhileForAWorkerOnWhichATaskHasNotFailedButNotForEver) {
  Bench bench;
  Unfold(&bench, "busy", "other");
  bench.Hello("a");  // Takes a window of "busy" and keeps it.
  bench.Submit("job", "leg", "", 5);
  const DispatchEffect first = OnlyDispatch(bench.Hello("b"));
  ASSERT_EQ(first.task.kind(), v1::INGEST);
  bench.Step(CancelJobEvent{"busy"});  // a does not answer: its slot stays taken while it says nothing for a lease.
  bench.Fail(first, StatusCode::kFailed, "odd");
  int waits = 0;
  std::vector<DispatchEffect> again;
  for (; again.empty() && waits < 100; ++waits) again = Only<DispatchEffect>(bench.Wait(bench.options.retry_delay_ms));
  ASSERT_THAT(again, SizeIs(1));
  EXPECT_EQ(again[0].worker_id, "b");
  EXPECT_GT(waits, 2);
}

TEST(PolicyTest, RetriesOnlyWhatFailedOfAJobThatEndedInPart) {
  Bench bench;
  bench.Hello("w");
  std::vector<DispatchEffect> out = Only<DispatchEffect>(bench.Submit("job"));
  while (!out.empty()) {
    const DispatchEffect now = out[0];
    const bool bad = TitleOf(now) == "ENHANCE window 2";
    out = Only<DispatchEffect>(bad ? bench.Fail(now, StatusCode::kInvalidInput, "no") : bench.Done(now));
  }
  ASSERT_EQ(bench.Status("job").state(), v1::JOB_DONE_IN_PART);
  EXPECT_THAT(bench.Submit("job"), IsEmpty()) << "it is done, in part";
  bench.Restart();
  bench.Hello("w");
  std::vector<std::string> titles;
  for (const DispatchEffect& dispatch : bench.RunAll(bench.Step(RetryJobEvent{"job"}))) titles.push_back(TitleOf(dispatch));
  EXPECT_THAT(titles, ElementsAre("ENHANCE window 2", "ALIGN", "COMPOSITE tile 0", "COMPOSITE tile 1", "COMPOSITE tile 2", "EXPORT"));
  EXPECT_EQ(bench.Status("job").state(), v1::JOB_DONE);
  EXPECT_THAT(bench.Status("job").holes(), IsEmpty());
  EXPECT_THAT(bench.Step(RetryJobEvent{"job"}), IsEmpty());
}

// ---- Damage -----------------------------------------------------------------------------------------------------------------------

TEST(PolicyTest, MakesADamagedInputAgainBeforeItTriesATaskAgain) {
  Bench bench;
  bench.Hello("w");
  DispatchEffect dispatch = OnlyDispatch(bench.Submit("job"));
  std::string window_key;
  while (dispatch.task.kind() != v1::ALIGN) {
    if (TitleOf(dispatch) == "ENHANCE window 1") window_key = dispatch.task.key();
    dispatch = OnlyDispatch(bench.Done(dispatch));
  }
  const std::string digest = dispatch.task.inputs(2).sha256();
  const DispatchEffect repair = OnlyDispatch(bench.Fail(dispatch, StatusCode::kCorrupt, "window.pb has another digest", {digest}));
  EXPECT_EQ(repair.task.key(), window_key);
  EXPECT_EQ(bench.Status("job").stages(v1::ENHANCE - 1).done(), kFakeWindowCount - 1);
  bench.Restart();
  EXPECT_EQ(bench.Status("job").stages(v1::ENHANCE - 1).done(), kFakeWindowCount - 1);
  bench.Hello("w", {AttemptOf(repair)});
  std::vector<Effect> effects = bench.Done(repair);
  EXPECT_EQ(bench.Status("job").stages(v1::ENHANCE - 1).done(), kFakeWindowCount);
  const auto more = bench.Wait(bench.options.restart_grace_ms + bench.options.retry_delay_ms);
  effects.insert(effects.end(), more.begin(), more.end());
  bench.RunAll(effects);
  EXPECT_EQ(bench.Status("job").state(), v1::JOB_DONE);
  EXPECT_THAT(bench.Status("job").notes(), IsEmpty()) << "the same bytes again are no news";
}

TEST(PolicyTest, DoesNotHoldDamagedInputsAgainstATaskButStopsRepairingInTheEnd) {
  Bench bench;
  bench.Hello("w");
  DispatchEffect dispatch = OnlyDispatch(bench.Submit("job"));
  while (dispatch.task.kind() != v1::ALIGN) dispatch = OnlyDispatch(bench.Done(dispatch));
  const std::string digest = dispatch.task.inputs(1).sha256();
  std::uint32_t repairs = 0;
  for (int i = 0; i < 100 && bench.Status("job").state() == v1::JOB_RUNNING; ++i) {
    std::vector<Effect> effects = bench.Fail(dispatch, StatusCode::kCorrupt, "bad again", {digest});
    for (const DispatchEffect& repair : Only<DispatchEffect>(effects)) {
      ++repairs;
      bench.Done(repair);
    }
    const auto again = Only<DispatchEffect>(bench.Wait(bench.options.retry_delay_ms_max));
    if (!again.empty()) dispatch = again[0];
  }
  EXPECT_EQ(repairs, bench.options.repairs_max);
  EXPECT_EQ(bench.Status("job").state(), v1::JOB_FAILED);
  EXPECT_THAT(bench.Status("job").error(), HasSubstr("bad again (after 3 attempts)"));
}

// ---- Stragglers -------------------------------------------------------------------------------------------------------------------

class HedgeTest : public ::testing::Test {
 protected:
  // All windows but the last are done within a second; the last one goes on, on "w1" of host "a".
  void SetUp() override {
    bench.Hello("w1", {}, 1, 0, "a");
    straggler = OnlyDispatch(bench.Submit("job"));
    for (int i = 0; i < 4; ++i) straggler = OnlyDispatch(bench.Done(straggler));
    ASSERT_EQ(TitleOf(straggler), "ENHANCE window 3");
  }
  // Keeps the lease for a while.
  std::vector<Effect> Work(TimeMs ms) {
    std::vector<Effect> effects;
    for (; ms > 0; ms -= 1'000) {
      bench.Progress(straggler);
      const auto more = bench.Wait(std::min<TimeMs>(ms, 1'000));
      effects.insert(effects.end(), more.begin(), more.end());
    }
    return effects;
  }
  Bench bench;
  DispatchEffect straggler;
};

TEST_F(HedgeTest, GivesAStragglerASecondAttemptOnAnotherHostAndTakesTheFirstResult) {
  EXPECT_THAT(Only<DispatchEffect>(Work(60'000)), IsEmpty()) << "there is no other worker";
  bench.Hello("w2", {}, 1, 0, "a");
  bench.Hello("w3", {}, 1, 0, "b");
  const DispatchEffect hedge = OnlyDispatch(Work(1'000));
  EXPECT_EQ(hedge.task.key(), straggler.task.key());
  EXPECT_EQ(hedge.attempt, straggler.attempt + 1);
  EXPECT_EQ(hedge.worker_id, "w3");
  EXPECT_EQ(bench.Status("job").stages(v1::ENHANCE - 1).running(), 1U) << "one task, whatever its attempts";
  EXPECT_THAT(Only<DispatchEffect>(Work(60'000 - 1)), IsEmpty()) << "one hedge is enough";
  // The lease of the hedge has ended by then; give it its place back before the old one wins.
  const auto effects = bench.Done(straggler);
  EXPECT_THAT(Only<DispatchEffect>(effects), SizeIs(1)) << "ALIGN follows: the older attempt's result was taken";
}

TEST_F(HedgeTest, CancelsTheSlowerAttempt) {
  bench.Hello("w2", {}, 1, 0, "b");
  const DispatchEffect hedge = OnlyDispatch(Work(6'000));
  const auto effects = bench.Done(hedge);
  const auto cancels = Only<CancelTaskEffect>(effects);
  ASSERT_THAT(cancels, SizeIs(1));
  EXPECT_EQ(cancels[0].worker_id, "w1");
  EXPECT_EQ(cancels[0].attempt, AttemptOf(straggler));
  EXPECT_THAT(Only<AppendEffect>(bench.Done(straggler)), IsEmpty()) << "the second result is as the first: nothing to write down";
}

TEST_F(HedgeTest, GoesOnWithTheOtherAttemptWhenOneFailsOrIsLost) {
  bench.Hello("w2", {}, 1, 0, "b");
  const DispatchEffect hedge = OnlyDispatch(Work(6'000));
  EXPECT_THAT(Only<DispatchEffect>(bench.Fail(hedge, StatusCode::kFailed, "no")), IsEmpty());
  EXPECT_THAT(Only<DispatchEffect>(Work(10'000)), IsEmpty());
  EXPECT_EQ(bench.Status("job").state(), v1::JOB_RUNNING);
  EXPECT_THAT(Only<DispatchEffect>(bench.Done(straggler)), SizeIs(1));
}

TEST_F(HedgeTest, DoesNotHedgeWhatTakesAsLongAsTheOthers) {
  bench.Hello("w2", {}, 1, 0, "b");
  EXPECT_THAT(Only<DispatchEffect>(Work(4'000)), IsEmpty()) << "not before five seconds";
  bench.options.hedge_factor = 0.0;
  EXPECT_THAT(Only<DispatchEffect>(Work(1'000)), SizeIs(1));
  Bench off(bench.options);
  off.Hello("w1");
  DispatchEffect last = OnlyDispatch(off.Submit("job"));
  for (int i = 0; i < 4; ++i) last = OnlyDispatch(off.Done(last));
  off.Hello("w2");
  for (int i = 0; i < 20; ++i) {
    off.Progress(last);
    EXPECT_THAT(Only<DispatchEffect>(off.Wait(1'000)), IsEmpty()) << "hedging is off";
  }
}

// ---- Leaving and coming back ------------------------------------------------------------------------------------------------------

TEST(PolicyTest, GivesADrainingWorkerNothingNew) {
  Bench bench;
  bench.Hello("w1");
  const DispatchEffect ingest = OnlyDispatch(bench.Submit("job"));
  const auto effects = bench.Step(DrainWorkerEvent{"w1"});
  ASSERT_THAT(Only<DrainWorkerEffect>(effects), SizeIs(1));
  EXPECT_TRUE(bench.scheduler.WorkerStatuses()[0].draining());
  EXPECT_THAT(Only<DispatchEffect>(bench.Done(ingest)), IsEmpty());
  EXPECT_EQ(OnlyDispatch(bench.Hello("w2")).worker_id, "w2");
  EXPECT_THAT(bench.Step(DrainWorkerEvent{"nobody"}), IsEmpty());
}

TEST(PolicyTest, ASnapshotIsTheShortestLogOfTheSameState) {
  Bench bench;
  bench.Hello("w");
  // One job done in part, one cancelled, one failed, one in the middle, after a failed try.
  std::vector<DispatchEffect> out = Only<DispatchEffect>(bench.Submit("part"));
  while (!out.empty()) {
    const DispatchEffect now = out[0];
    out = Only<DispatchEffect>(TitleOf(now) == "ENHANCE window 2" ? bench.Fail(now, StatusCode::kInvalidInput, "no") : bench.Done(now));
  }
  bench.Step(WorkerGoodbyeEvent{"w"});
  bench.Submit("gone", "gone", "ann", 3);
  bench.Step(CancelJobEvent{"gone"});
  bench.Hello("w");
  bench.Fail(OnlyDispatch(bench.Submit("failed", "failed")), StatusCode::kNotFound, "no such file");
  DispatchEffect middle = OnlyDispatch(bench.Submit("middle", "middle", "bob", -2));
  bench.Fail(middle, StatusCode::kFailed, "odd");
  middle = OnlyDispatch(bench.Wait(bench.options.retry_delay_ms));
  middle = OnlyDispatch(bench.Done(middle));

  const auto statuses = [&] {
    std::string text;
    for (v1::JobStatus status : bench.scheduler.JobStatuses()) {
      status.set_worker_count(0);
      status.set_retries(0);
      for (v1::StageStatus& stage : *status.mutable_stages()) stage.set_running(0);
      status.set_eta_s(0);
      text += status.DebugString();
    }
    return text;
  };
  const std::string before = statuses();
  const std::size_t log_size = bench.log.size();
  bench.RestartFromSnapshot();
  EXPECT_EQ(statuses(), before);
  EXPECT_LT(bench.log.size(), log_size);
  const auto again = bench.scheduler.Snapshot();
  EXPECT_EQ(again.size(), bench.log.size());
  EXPECT_THAT(bench.Hello("w", {AttemptOf(middle)}), IsEmpty()) << "it goes on with what it has";
  EXPECT_THAT(Only<DispatchEffect>(bench.Done(middle)), SizeIs(1));
}

}  // namespace
}  // namespace trem::testing
