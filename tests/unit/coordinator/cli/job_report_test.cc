// Goal: what a program or a person reads about a job is complete and valid. Method: a job made by hand, read back with the JSON parser.
#include "coordinator/cli/job_report.h"

#include <gtest/gtest.h>

#include "mosaic/base/status.h"

namespace trem {
namespace {

v1::JobStatus FailedJob(int warning_count) {
  v1::JobStatus job;
  job.set_job_id("run-1");
  job.set_state(v1::JOB_FAILED);
  job.set_error("frame 3: broken \xff byte");
  job.set_error_code(static_cast<std::uint32_t>(StatusCode::kExhausted));
  job.set_eta_s(-1);
  v1::StageStatus* stage = job.add_stages();
  stage->set_kind(v1::ENHANCE);
  stage->set_total(4);
  for (int i = 0; i < warning_count; ++i) {
    v1::Note* note = job.add_notes();
    note->set_severity(v1::WARNING);
    note->set_subject("f" + std::to_string(i) + ".png");
    note->set_message("unreadable");
  }
  job.add_notes()->set_message("just so");  // INFO.
  return job;
}

TEST(JobJson, IsValidJsonWhateverBytesTheMessagesHold) {
  const auto json = nlohmann::json::parse(DumpJson(JobJson(FailedJob(1))));
  EXPECT_EQ(json["state"], "failed");
  EXPECT_EQ(json["error"]["code"], ToString(StatusCode::kExhausted));
  EXPECT_TRUE(json["eta_s"].is_null());
  EXPECT_EQ(json["stages"][0]["kind"], "enhance");
  EXPECT_EQ(json["notes"].size(), 2u);
}

TEST(WarningLines, ListsWarningsOnlyAndCountsTheRest) {
  EXPECT_EQ(WarningLines(FailedJob(2), 10), (std::vector<std::string>{"f0.png: unreadable", "f1.png: unreadable"}));
  const std::vector<std::string> lines = WarningLines(FailedJob(13), 10);
  ASSERT_EQ(lines.size(), 11u);
  EXPECT_EQ(lines.back(), "... and 3 more; --json lists all");
}

}  // namespace
}  // namespace trem
