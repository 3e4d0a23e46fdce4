// Goal: results appear under the user's names, all or nothing. Method: a real artefact store in a temporary folder, with a damaged object,
// a missing object and a name in the way.
#include "coordinator/cli/outputs.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "mosaic/base/artefact_store.h"
#include "mosaic/base/file.h"
#include "proto/codec/convert.h"
#include "tests/support/paths.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using testing::FileContents;
using ::testing::HasSubstr;
using testing::TempDir;
using testing::WriteFileContents;

class PublishOutputsTest : public ::testing::Test {
 protected:
  PublishOutputsTest() {
    fs::create_directories(work_);
    fs::create_directories(out_);
    const auto store = ArtefactStore::Open(store_path_);
    for (const char* name : {"mosaic.tif", "mosaic_quality.tif", "mosaic_chain.csv"}) {
      *job_.add_outputs() = ToProto(*store->PutBytes(name, std::string("content of ") + name));
    }
  }
  fs::path ObjectOf(int index) const { return *ArtefactStore::Open(store_path_)->Locate(FromProto(job_.outputs(index))); }
  std::vector<std::string> NamesInOut() const {
    std::vector<std::string> names;
    for (const auto& entry : fs::directory_iterator(out_)) names.push_back(entry.path().filename());
    return names;
  }

  TempDir folder_;
  fs::path store_path_ = folder_ / "store";
  fs::path work_ = folder_ / "work";
  fs::path out_ = folder_ / "out";
  v1::JobStatus job_;
};

TEST_F(PublishOutputsTest, NamesTheSiblingsAfterTheMosaic) {
  const auto files = PublishOutputs(job_, *ArtefactStore::Open(store_path_), out_ / "town.tif", work_);
  ASSERT_TRUE(files.ok()) << files.status().ToString();
  ASSERT_EQ(files->size(), 3u);
  EXPECT_EQ(files->front().path, out_ / "town.tif");
  EXPECT_EQ(FileContents(out_ / "town.tif"), "content of mosaic.tif");
  EXPECT_EQ(FileContents(out_ / "town_quality.tif"), "content of mosaic_quality.tif");
  EXPECT_EQ(FileContents(out_ / "town_chain.csv"), "content of mosaic_chain.csv");
  EXPECT_EQ(NamesInOut().size(), 3u);
  EXPECT_TRUE(fs::is_empty(work_));
}

TEST_F(PublishOutputsTest, StagesBesideTheOutputWithoutAWorkFolder) {
  ASSERT_TRUE(PublishOutputs(job_, *ArtefactStore::Open(store_path_), out_ / "town.tif", {}).ok());
  EXPECT_EQ(NamesInOut().size(), 3u);
}

TEST_F(PublishOutputsTest, ReplacesAnEarlierMosaic) {
  WriteFileContents(out_ / "town.tif", "old");
  ASSERT_TRUE(PublishOutputs(job_, *ArtefactStore::Open(store_path_), out_ / "town.tif", work_).ok());
  EXPECT_EQ(FileContents(out_ / "town.tif"), "content of mosaic.tif");
}

TEST_F(PublishOutputsTest, PublishesNothingWhenOneResultIsDamaged) {
  fs::permissions(ObjectOf(2), fs::perms::owner_all);
  WriteFileContents(ObjectOf(2), "CONTENT of mosaic_chain.csv");  // Same size, other bytes.
  const auto files = PublishOutputs(job_, *ArtefactStore::Open(store_path_), out_ / "town.tif", work_);
  ASSERT_FALSE(files.ok());
  EXPECT_EQ(files.status().code(), StatusCode::kCorrupt);
  EXPECT_THAT(files.status().message(), HasSubstr("mosaic_chain.csv"));
  EXPECT_TRUE(fs::is_empty(out_));
  EXPECT_TRUE(fs::is_empty(work_));
}

TEST_F(PublishOutputsTest, PublishesNothingWhenOneResultIsMissing) {
  fs::remove(ObjectOf(0));
  const auto files = PublishOutputs(job_, *ArtefactStore::Open(store_path_), out_ / "town.tif", work_);
  ASSERT_FALSE(files.ok());
  EXPECT_EQ(files.status().code(), StatusCode::kNotFound);
  EXPECT_TRUE(fs::is_empty(out_));
}

TEST(OutputPath, KeepsHostileNamesInsideTheFolder) {
  for (const char* name : {"", "../x.tif", "a/b", ".hidden"}) {
    EXPECT_EQ(OutputPath("out/town.tif", name).status().code(), StatusCode::kCorrupt) << name;
  }
  EXPECT_EQ(*OutputPath("out/town.tif", "mosaic.stac.json"), fs::path("out/town.stac.json"));
  EXPECT_EQ(*OutputPath("out/town.tif", "other.csv"), fs::path("out/town_other.csv"));
}

TEST(CheckOutput, NamesWhatIsWrongWithTheOutput) {
  TempDir folder;
  WriteFileContents(folder / "file", "");
  EXPECT_TRUE(CheckOutput(folder / "mosaic.tif").ok());
  EXPECT_TRUE(CheckOutput(folder / "mosaic.TIFF").ok());
  EXPECT_THAT(CheckOutput(folder.path()).message(), HasSubstr("is a folder"));
  EXPECT_THAT(CheckOutput(folder / "mosaic.jpg").message(), HasSubstr("does not end in .tif"));
  EXPECT_THAT(CheckOutput(folder.path() / "no" / "mosaic.tif").message(), HasSubstr("does not exist"));
  EXPECT_THAT(CheckOutput(folder.path() / "file" / "mosaic.tif").message(), HasSubstr("not a folder"));
  EXPECT_FALSE(CheckOutput("/proc/mosaic.tif").ok());
}

}  // namespace
}  // namespace trem
