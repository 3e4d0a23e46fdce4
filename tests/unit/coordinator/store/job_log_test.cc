// Goal: what happened to a job can be asked for, by task, attempt and worker, from where one stopped reading; nothing that a worker says
// can break a line, and no job can fill the disk. Method: logs in a temporary folder.
#include "coordinator/store/job_log.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <string>
#include <vector>

#include "tests/support/paths.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::IsEmpty;
using trem::testing::FileContents;
using trem::testing::TempDir;
using trem::testing::WriteFileContents;

v1::LogLine Line(const std::string& text, const std::string& task = "", std::uint32_t attempt = 0, const std::string& worker = "") {
  v1::LogLine line;
  line.set_time_ms(1'700'000'000'000);
  line.set_text(text);
  line.set_task(task);
  line.set_task_key(task.empty() ? "" : std::string(64, task.back()));
  line.set_attempt(attempt);
  line.set_worker_id(worker);
  return line;
}

v1::GetLog Get(const std::string& job_id, std::uint64_t after = 0) {
  v1::GetLog get;
  get.set_job_id(job_id);
  get.set_after(after);
  return get;
}

std::vector<std::string> Texts(const v1::LogPage& page) {
  std::vector<std::string> texts;
  for (const v1::LogLine& line : page.lines()) texts.push_back(line.text());
  return texts;
}

TEST(JobLog, TellsEachJobItsOwnLinesAndGoesOnFromWhereOneStopped) {
  const TempDir folder;
  JobLog log(folder / "logs");
  log.Append("one", Line("a"));
  log.Append("two", Line("b"));
  v1::LogPage page = log.Page(Get("one"));
  EXPECT_THAT(Texts(page), ElementsAre("a"));
  EXPECT_TRUE(page.is_last());
  log.Append("one", Line("c"));
  page = log.Page(Get("one", page.next_after()));
  EXPECT_THAT(Texts(page), ElementsAre("c"));
  EXPECT_THAT(Texts(log.Page(Get("one", page.next_after()))), IsEmpty());
  EXPECT_THAT(Texts(log.Page(Get("nobody"))), IsEmpty());
}

TEST(JobLog, FindsLinesByTaskAttemptAndWorker) {
  const TempDir folder;
  JobLog log(folder / "logs");
  log.Append("job", Line("a", "ENHANCE window 7", 1, "w1"));
  log.Append("job", Line("b", "ENHANCE window 7", 2, "w2"));
  log.Append("job", Line("c", "ENHANCE window 8", 1, "w1"));
  v1::GetLog get = Get("job");
  get.set_task("enhance window 7");
  EXPECT_THAT(Texts(log.Page(get)), ElementsAre("a", "b"));
  get.set_attempt(2);
  EXPECT_THAT(Texts(log.Page(get)), ElementsAre("b"));
  get = Get("job");
  get.set_task(std::string(64, '8'));  // Its key.
  EXPECT_THAT(Texts(log.Page(get)), ElementsAre("c"));
  get = Get("job");
  get.set_worker_id("w1");
  EXPECT_THAT(Texts(log.Page(get)), ElementsAre("a", "c"));
}

TEST(JobLog, NothingInATextBreaksALineOrReachesATerminal) {
  const TempDir folder;
  JobLog log(folder / "logs");
  log.Append("job",
             Line("tab\there, line\nend, escape \x1b[2J, not UTF-8 \xff\xc0\xaf, surrogate \xed\xa0\x80, c1 \xc2\x9b, fine \xc3\xa9"));
  log.Append("job", Line(std::string(100'000, 'x')));
  const v1::LogPage page = log.Page(Get("job"));
  ASSERT_EQ(page.lines_size(), 2);
  EXPECT_EQ(page.lines(0).text(), "tab here, line end, escape  [2J, not UTF-8 ???, surrogate ???, c1 ??, fine \xc3\xa9");
  EXPECT_LT(page.lines(1).text().size(), 3000U);
}

TEST(JobLog, NumbersGoOnAfterARestartAndHalfALineIsLeftOut) {
  const TempDir folder;
  {
    JobLog log(folder / "logs");
    log.Append("job", Line("a"));
    log.Append("job", Line("b"));
    log.Flush();
  }
  const fs::path path = folder / "logs" / "job.log";
  WriteFileContents(path, FileContents(path) + "not a line\n3\t17");
  JobLog log(folder / "logs");
  WriteFileContents(path, FileContents(path) + "\n");
  log.Append("job", Line("c"));
  EXPECT_THAT(Texts(log.Page(Get("job", 2))), ElementsAre("c"));
}

TEST(JobLog, KeepsTheNewestLinesOfALongLogAndPagesThroughThem) {
  const TempDir folder;
  JobLogOptions options;
  options.job_bytes_max = 2 << 20;
  JobLog log(folder / "logs", options);
  constexpr int kLines = 40'000;
  for (int i = 1; i <= kLines; ++i) log.Append("job", Line("line " + std::to_string(i) + std::string(60, '.')));
  log.Flush();
  EXPECT_LE(trem::testing::FileContents(folder / "logs" / "job.log").size(), options.job_bytes_max / 2);
  std::uint64_t after = 0, count = 0, pages = 0;
  for (bool is_last = false; !is_last; ++pages) {
    const v1::LogPage page = log.Page(Get("job", after));
    EXPECT_LE(page.ByteSizeLong(), 300'000U);
    for (const v1::LogLine& line : page.lines()) {
      EXPECT_GT(line.number(), after);
      after = line.number();
      ++count;
    }
    EXPECT_EQ(page.next_after(), after);
    is_last = page.is_last();
  }
  EXPECT_EQ(after, static_cast<std::uint64_t>(kLines));
  EXPECT_GT(count * 100, options.job_bytes_max / 2) << "at least half of the bound is kept";
  EXPECT_GT(pages, 2U);
  v1::GetLog newest = Get("job");
  newest.set_newest(true);
  EXPECT_EQ(log.Page(newest).lines().rbegin()->number(), static_cast<std::uint64_t>(kLines));
}

TEST(JobLog, TheOldestLogsGoWhenAllTogetherAreTooLarge) {
  const TempDir folder;
  JobLogOptions options;
  options.job_bytes_max = 64 << 10;
  options.bytes_max = 256 << 10;
  JobLog log(folder / "logs", options);
  for (int job = 0; job < 40; ++job) {
    for (int i = 0; i < 200; ++i) log.Append("job-" + std::to_string(job), Line(std::string(100, '.')));
    log.Flush();
  }
  std::uint64_t total = 0;
  for (const auto& entry : fs::directory_iterator(folder / "logs")) total += entry.file_size();
  EXPECT_LE(total, options.bytes_max + options.bytes_max / 8);
  EXPECT_EQ(log.Page(Get("job-39")).lines_size(), 200);
  EXPECT_EQ(log.lost_count(), 0U);
}

}  // namespace
}  // namespace trem
