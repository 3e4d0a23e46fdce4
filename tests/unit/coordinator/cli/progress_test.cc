// Goal: the progress line names the stage that is under way and never lies about being done. Method: job states made by hand.
#include "coordinator/cli/progress.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

namespace trem {
namespace {

v1::JobStatus RunningJob() {
  v1::JobStatus job;
  job.set_state(v1::JOB_RUNNING);
  job.set_fraction(0.999);
  job.set_worker_count(2);
  job.set_eta_s(80);
  const auto add = [&](v1::TaskKind kind, std::uint32_t done, std::uint32_t total) {
    v1::StageStatus* stage = job.add_stages();
    stage->set_kind(kind);
    stage->set_done(done);
    stage->set_total(total);
  };
  add(v1::INGEST, 1, 1);
  add(v1::ENHANCE, 12, 40);
  add(v1::ALIGN, 0, 1);
  add(v1::COMPOSITE, 0, 0);
  return job;
}

TEST(ProgressLine, NamesTheFirstStageThatIsNotDone) {
  EXPECT_EQ(StageText(RunningJob()), "enhance 12/40");
  EXPECT_EQ(ProgressLine(RunningJob()), " 99% enhance 12/40, 2 workers, about 1:20 left");
}

TEST(ProgressLine, TellsHowSureTheEstimateIs) {
  v1::JobStatus job = RunningJob();
  job.set_eta_low_s(65);
  job.set_eta_high_s(110);
  EXPECT_EQ(TimeLeftText(job), "1:20 left (1:05 to 1:50)");
  EXPECT_EQ(ProgressLine(job), " 99% enhance 12/40, 2 workers, about 1:20 left (1:05 to 1:50)");
}

TEST(ProgressLine, DoesNotInventAnEstimate) {
  v1::JobStatus job = RunningJob();
  job.set_eta_s(-1);
  EXPECT_THAT(ProgressLine(job), ::testing::Not(::testing::HasSubstr("left")));
}

TEST(ProgressLine, WaitsBeforeAnyTaskIsKnown) {
  v1::JobStatus job;
  job.set_state(v1::JOB_RUNNING);
  job.set_fraction(std::numeric_limits<double>::quiet_NaN());
  EXPECT_EQ(ProgressLine(job), "  0% waiting, 0 workers");
}

TEST(ProgressLine, SaysDoneOnlyWhenTheJobIs) {
  v1::JobStatus job = RunningJob();
  job.set_state(v1::JOB_DONE);
  job.set_fraction(1.0);
  EXPECT_EQ(ProgressLine(job), "100% done, 2 workers");
}

TEST(ProgressBar, FitsTheTerminal) {
  for (const int columns : {0, 5, 20, 40, 60, 80, 200}) {
    EXPECT_LE(ProgressBar(RunningJob(), columns).size(), static_cast<std::size_t>(columns)) << columns;
  }
  v1::JobStatus half = RunningJob();
  half.set_fraction(0.5);
  EXPECT_THAT(ProgressBar(half, 200), ::testing::StartsWith("[###############...............]  50%"));
}

}  // namespace
}  // namespace trem
