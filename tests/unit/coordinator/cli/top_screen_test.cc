// Goal: `trem top` shows the urgent first, fits its screen, and counts what does not fit. Method: views made by hand.
#include "coordinator/cli/top_screen.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

namespace trem {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

v1::JobStatus Job(const std::string& id, v1::JobState state, int priority = 0) {
  v1::JobStatus job;
  job.set_job_id(id);
  job.set_state(state);
  job.set_priority(priority);
  job.set_eta_s(-1);
  v1::StageStatus* stage = job.add_stages();
  stage->set_kind(v1::ENHANCE);
  stage->set_total(10);
  stage->set_done(4);
  stage->set_running(2);
  return job;
}

v1::WorkerStatus Worker(const std::string& id, bool busy) {
  v1::WorkerStatus worker;
  worker.set_worker_id(id);
  if (!busy) return worker;
  worker.add_running();
  v1::RunningTask* task = worker.add_tasks();
  task->set_title("ENHANCE window 7\x1b[2J");
  task->set_job_id("a");
  task->set_attempt(2);
  task->set_fraction(0.5);
  return worker;
}

TEST(TopScreen, ShowsRunningJobsByUrgencyAndBusyWorkersFirst) {
  FleetView view;
  view.coordinator = "ipc:///x";
  view.jobs = {Job("old", v1::JOB_DONE), Job("failed", v1::JOB_FAILED), Job("low", v1::JOB_RUNNING), Job("high", v1::JOB_RUNNING, 5)};
  view.workers = {Worker("w-idle", false), Worker("w-busy", true)};
  view.tasks_per_s = 12.5;
  const auto screen = TopScreen(view, 0, 0);
  ASSERT_EQ(screen.size(), 10u);
  EXPECT_EQ(screen[0], "ipc:///x: 2 running, 2 other jobs (1 failed); 2 workers, 1 busy; 8 tasks wait; 12.5 tasks/s");
  EXPECT_THAT(screen[2], StartsWith("high "));
  EXPECT_THAT(screen[3], StartsWith("low "));
  EXPECT_THAT(screen[4], StartsWith("failed "));
  EXPECT_THAT(screen[5], StartsWith("old "));
  EXPECT_THAT(screen[8], HasSubstr("ENHANCE window 7?[2J of a #2 50%")) << "control characters do not reach the terminal";
  EXPECT_THAT(screen[9], HasSubstr("idle"));
}

TEST(TopScreen, FitsItsScreenAndCountsTheRest) {
  FleetView view;
  for (int i = 0; i < 50; ++i) view.jobs.push_back(Job("job-" + std::to_string(i), v1::JOB_RUNNING));
  for (int i = 0; i < 50; ++i) view.workers.push_back(Worker("worker-" + std::to_string(i), true));
  for (const int rows : {5, 10, 24, 60}) {
    const auto screen = TopScreen(view, 60, rows);
    EXPECT_LE(screen.size(), static_cast<std::size_t>(rows));
    for (const std::string& line : screen) EXPECT_LE(line.size(), 60u);
  }
  const auto screen = TopScreen(view, 0, 24);
  EXPECT_EQ(screen.size(), 24u);
  EXPECT_EQ(screen[11], "... and 41 more");
  EXPECT_EQ(screen.back(), "... and 41 more");
}

}  // namespace
}  // namespace trem
