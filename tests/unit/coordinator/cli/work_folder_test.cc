// Goal: one run at a time in a work folder, and a job id that follows the input. Method: real folders and locks; change one thing at a
// time.
#include "coordinator/cli/work_folder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <optional>

#include "tests/support/paths.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using testing::TempDir;
using testing::WriteFileContents;

TEST(WorkFolder, IsHeldByOneRunAtATime) {
  TempDir folder;
  std::optional<Result<WorkFolder>> first = WorkFolder::Open(folder / "m.tif.work");
  ASSERT_TRUE(first->ok());
  EXPECT_TRUE((*first)->is_new());
  const Result<WorkFolder> second = WorkFolder::Open(folder / "m.tif.work");
  ASSERT_FALSE(second.ok());
  EXPECT_THAT(second.status().message(), ::testing::HasSubstr("another 'trem run' is using"));
  first.reset();
  const Result<WorkFolder> third = WorkFolder::Open(folder / "m.tif.work");
  ASSERT_TRUE(third.ok()) << third.status().ToString();
  EXPECT_FALSE(third->is_new());
}

TEST(WorkFolder, RemovesItsOwnFilesOnly) {
  TempDir folder;
  const fs::path path = folder / "work";
  {
    Result<WorkFolder> work = WorkFolder::Open(path);
    ASSERT_TRUE(work.ok());
    fs::create_directories(path / "store" / "objects");
    WriteFileContents(path / "mine.txt", "keep");
    work->Remove();
  }
  EXPECT_FALSE(fs::exists(path / "store"));
  EXPECT_TRUE(fs::exists(path / "mine.txt"));
  fs::remove(path / "mine.txt");
  Result<WorkFolder> work = WorkFolder::Open(path);
  ASSERT_TRUE(work.ok());
  work->Remove();
  EXPECT_FALSE(fs::exists(path));
}

TEST(RunJobId, ChangesWithTheSpecAndWithTheInputOnly) {
  TempDir folder;
  const fs::path frames = folder / "frames";
  fs::create_directories(frames);
  WriteFileContents(frames / "a.png", "a");
  v1::Sortie sortie;
  sortie.mutable_source()->set_path(frames.string());
  const std::string id = *RunJobId(sortie);
  EXPECT_THAT(id, ::testing::MatchesRegex("run-[0-9a-f]{24}"));
  EXPECT_EQ(*RunJobId(sortie), id);
  fs::create_directories(folder / "unrelated");
  WriteFileContents(folder / "mosaic.tif", "an output beside the frames");
  EXPECT_EQ(*RunJobId(sortie), id);

  v1::Sortie other = sortie;
  other.mutable_tre()->set_ratio(2);
  EXPECT_NE(*RunJobId(other), id);
  WriteFileContents(folder / "telemetry.csv", "frame");
  const std::string with_telemetry = *RunJobId(sortie);
  EXPECT_NE(with_telemetry, id);
  WriteFileContents(frames / "a.png", "longer");
  EXPECT_NE(*RunJobId(sortie), with_telemetry);

  sortie.mutable_source()->set_path((frames / "*.png").string());
  EXPECT_TRUE(RunJobId(sortie).ok());
  sortie.mutable_source()->set_path((frames / "*.jpg").string());
  EXPECT_EQ(RunJobId(sortie).status().code(), StatusCode::kNotFound);
}

}  // namespace
}  // namespace trem
