// Goal: a scratch folder lives as long as its process, and what a killed process left is removed by the next one, but nobody else's folder.
// Method: folders made, left without a lock's holder, held, or no folders at all.
#include "worker/app/scratch_folder.h"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <optional>

#include "tests/support/paths.h"

namespace trem {
namespace {

namespace fs = std::filesystem;

TEST(ScratchFolderTest, IsThereAsLongAsItIsHeld) {
  const testing::TempDir folder;
  fs::path path;
  {
    const ScratchFolder scratch = ScratchFolder::Make(folder / "tmp").value();
    path = scratch.path();
    EXPECT_EQ(fs::status(path).permissions(), fs::perms::owner_all);
    testing::WriteFileContents(path / "file", "x");
    const ScratchFolder other = ScratchFolder::Make(folder / "tmp").value();
    EXPECT_NE(other.path(), path);
    EXPECT_TRUE(fs::exists(path / "file")) << "another's folder was removed while it was held";
  }
  EXPECT_FALSE(fs::exists(path));
}

TEST(ScratchFolderTest, RemovesWhatAKilledProcessLeft) {
  const testing::TempDir folder;
  const pid_t child = ::fork();
  if (child == 0) {
    const auto scratch = ScratchFolder::Make(folder / "tmp");
    if (scratch.ok()) ::raise(SIGKILL);
    ::_exit(1);
  }
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  ASSERT_TRUE(WIFSIGNALED(status));
  ASSERT_FALSE(fs::is_empty(folder / "tmp"));
  const fs::path left = fs::directory_iterator(folder / "tmp")->path();
  const ScratchFolder scratch = ScratchFolder::Make(folder / "tmp").value();
  EXPECT_FALSE(fs::exists(left));
}

TEST(ScratchFolderTest, TouchesNothingElse) {
  const testing::TempDir folder;
  fs::create_directories(folder / "tmp/other/lock");
  fs::create_directories(folder / "elsewhere");
  testing::WriteFileContents(folder / "elsewhere/lock", "");
  fs::create_directory_symlink(folder / "elsewhere", folder / "tmp/trem-worker-linked");
  testing::WriteFileContents(folder / "tmp/trem-worker-file", "x");
  const ScratchFolder scratch = ScratchFolder::Make(folder / "tmp").value();
  for (const char* kept : {"tmp/other/lock", "elsewhere/lock", "tmp/trem-worker-linked", "tmp/trem-worker-file"}) {
    EXPECT_TRUE(fs::exists(folder / kept)) << kept;
  }
}

}  // namespace
}  // namespace trem
