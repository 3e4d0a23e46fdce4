// Goal: RunTask calls the function of the task's kind and turns whatever it throws into a Status whose code decides the retry.
// Method: run_task.cc is compiled into this test with task functions of our own, which return or throw what the test asks for.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <memory>
#include <new>
#include <opencv2/core.hpp>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "worker/tasks/task.h"

namespace trem {
namespace {

using ::testing::HasSubstr;

std::function<void()> on_run;

Result<v1::TaskResult> Ran(const char* name) {
  if (on_run) on_run();
  v1::TaskResult result;
  result.add_outputs()->set_name(name);
  return result;
}

}  // namespace

Result<v1::TaskResult> RunIngestTask(const v1::TaskSpec&, const TaskContext&) { return Ran("ingest"); }
Result<v1::TaskResult> RunEnhanceTask(const v1::TaskSpec&, const TaskContext&) { return Ran("enhance"); }
Result<v1::TaskResult> RunAlignTask(const v1::TaskSpec&, const TaskContext&) { return Ran("align"); }
Result<v1::TaskResult> RunCompositeTask(const v1::TaskSpec&, const TaskContext&) { return Ran("composite"); }
Result<v1::TaskResult> RunExportTask(const v1::TaskSpec&, const TaskContext&) { return Ran("export"); }

namespace {

class RunTaskTest : public ::testing::Test {
 protected:
  void SetUp() override {
    auto store = ArtefactStore::Open(::testing::TempDir() + "/run_task_store");
    ASSERT_TRUE(store.ok());
    store_ = std::make_unique<ArtefactStore>(std::move(store).value());
  }
  void TearDown() override { on_run = nullptr; }

  Result<v1::TaskResult> Run(v1::TaskKind kind) {
    v1::TaskSpec spec;
    spec.set_key(std::string(64, 'a'));
    spec.set_kind(kind);
    return RunTask(spec, {store_.get(), [](double) { return true; }});
  }
  Status Throwing(std::function<void()> thrower) {
    on_run = std::move(thrower);
    return Run(v1::ENHANCE).status();
  }

  std::unique_ptr<ArtefactStore> store_;
};

TEST_F(RunTaskTest, CallsTheFunctionOfTheKind) {
  const std::vector<std::pair<v1::TaskKind, std::string>> kinds = {
      {v1::INGEST, "ingest"}, {v1::ENHANCE, "enhance"}, {v1::ALIGN, "align"}, {v1::COMPOSITE, "composite"}, {v1::EXPORT, "export"}};
  for (const auto& [kind, name] : kinds) {
    const auto result = Run(kind);
    ASSERT_TRUE(result.ok()) << name;
    EXPECT_EQ(result->outputs(0).name(), name);
  }
}

TEST_F(RunTaskTest, RefusesUnknownKinds) {
  for (const int kind : {0, 42}) {
    const auto result = Run(static_cast<v1::TaskKind>(kind));
    ASSERT_FALSE(result.ok());
    EXPECT_EQ(result.status().code(), StatusCode::kInvalidInput);
    EXPECT_THAT(result.status().message(), HasSubstr("expected INGEST, ENHANCE, ALIGN, COMPOSITE or EXPORT"));
  }
}

TEST_F(RunTaskTest, TurnsExceptionsIntoStatuses) {
  const Status opencv = Throwing([] { CV_Error(cv::Error::StsBadArg, "bad kernel"); });
  EXPECT_EQ(opencv.code(), StatusCode::kFailed);
  EXPECT_THAT(opencv.message(), HasSubstr("bad kernel"));
  EXPECT_EQ(Throwing([] { CV_Error(cv::Error::StsNoMem, "no"); }).code(), StatusCode::kExhausted);
  EXPECT_EQ(Throwing([] { throw std::bad_alloc(); }).code(), StatusCode::kExhausted);
  const Status other = Throwing([] { throw std::runtime_error("odd"); });
  EXPECT_EQ(other.code(), StatusCode::kFailed);
  EXPECT_EQ(other.message(), "ENHANCE task: odd");
}

TEST_F(RunTaskTest, LeavesOpenCvOneThread) {
  ASSERT_TRUE(Run(v1::INGEST).ok());
  EXPECT_EQ(cv::getNumThreads(), 1);
}

}  // namespace
}  // namespace trem
