// Goal: LoadSortie tells specs, videos, folders and globs apart, resolves paths against the right folder, and says in one sentence what
// is not there. Method: a temporary folder with small files.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <stdlib.h>

#include <filesystem>

#include "mosaic/base/file.h"
#include "proto/codec/sortie_spec.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class LoadSortieTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string pattern = (fs::temp_directory_path() / "trem-load-XXXXXX").string();
    ASSERT_NE(::mkdtemp(pattern.data()), nullptr);
    root_ = pattern;
    fs::create_directories(root_ / "leg/frames");
    fs::create_directories(root_ / "empty");
    Write("leg/frames/a.png", "x");
    Write("leg/clip.mp4", "x");
    Write("leg/telemetry.csv", "frame\n");
    previous_ = fs::current_path();
    fs::current_path(root_);
  }
  void TearDown() override {
    fs::current_path(previous_);
    fs::remove_all(root_);
  }
  void Write(const std::string& name, const std::string& text) { ASSERT_TRUE(WriteFileAtomically(root_ / name, text).ok()); }
  std::string SourceOf(const std::string& argument, const std::vector<std::string>& overrides = {}) {
    const auto sortie = LoadSortie(argument, overrides);
    return sortie.ok() ? sortie->source().path() : sortie.status().ToString();
  }
  std::string In(const std::string& name) { return (root_ / name).string(); }

  fs::path root_;
  fs::path previous_;
};

TEST_F(LoadSortieTest, TakesVideosFoldersImagesAndGlobsAsTheSource) {
  EXPECT_EQ(SourceOf("leg/clip.mp4"), In("leg/clip.mp4"));
  EXPECT_EQ(SourceOf("./leg/frames/"), In("leg/frames"));
  EXPECT_EQ(SourceOf("leg/frames/a.png"), In("leg/frames/a.png"));
  EXPECT_EQ(SourceOf("leg/fr*/[ab].p?g"), In("leg/fr*/[ab].p?g"));
  EXPECT_EQ(SourceOf(In("leg/../leg/frames")), In("leg/frames"));
}

TEST_F(LoadSortieTest, ResolvesPathsOfASpecAgainstItsFolderAndOverridesAgainstTheWorkingFolder) {
  Write("leg/spec.textproto", "source { path: \"frames\" } telemetry { path: \"telemetry.csv\" }");
  Write("leg/spec.json", "{\"source\": {\"path\": \"./frames/\"}}");
  const auto text = LoadSortie("leg/spec.textproto", {"tre.ratio=2"});
  ASSERT_TRUE(text.ok()) << text.status().message();
  EXPECT_EQ(text->source().path(), In("leg/frames"));
  EXPECT_EQ(text->telemetry().path(), In("leg/telemetry.csv"));
  EXPECT_EQ(text->tre().ratio(), 2u);
  EXPECT_EQ(text->name(), "frames");
  EXPECT_EQ(SourceOf("leg/spec.json"), In("leg/frames"));
  EXPECT_EQ(SourceOf("leg/spec.json", {"source.path=leg/clip.mp4"}), In("leg/clip.mp4"));
}

TEST_F(LoadSortieTest, SaysWhatIsNotThere) {
  EXPECT_EQ(SourceOf("leg/nothing"), "not found: no such file or folder: leg/nothing (looked from " + root_.string() +
                                         "); expected a sortie spec, a video, a folder of images or a glob");
  EXPECT_THAT(SourceOf("leg/*.tif"), HasSubstr("not found: nothing matches the glob: leg/*.tif (looked from "));
  EXPECT_THAT(SourceOf("nothing.json"), HasSubstr("not found: no such file or folder: nothing.json"));
  EXPECT_EQ(SourceOf("empty"), "not found: source.path: the folder " + In("empty") + " is empty; expected images in it");
  Write("leg/spec.textproto", "source { path: \"gone\" }");
  EXPECT_THAT(SourceOf("leg/spec.textproto"), HasSubstr("not found: source.path: no such file or folder: " + In("leg/gone")));
  Write("leg/spec.textproto", "source { path: \"frames\" } telemetry { path: \"gone.csv\" }");
  EXPECT_THAT(SourceOf("leg/spec.textproto"), HasSubstr("not found: telemetry.path: no such file or folder: " + In("leg/gone.csv")));
  Write("leg/spec.textproto", "source { path: \"frames\" } telemetry { dem_path: \"gone.tif\" }");
  EXPECT_THAT(SourceOf("leg/spec.textproto"), HasSubstr("not found: telemetry.dem_path: no such file or folder: " + In("leg/gone.tif")));
}

TEST_F(LoadSortieTest, RefusesSpecsWithMistakesByFileAndPlace) {
  Write("leg/spec.json", "{}");
  EXPECT_THAT(SourceOf("leg/spec.json"), HasSubstr("invalid input: leg/spec.json: source.path is missing"));
  Write("leg/spec.json", "{\"source\": {\"pth\": \"frames\"}}");
  EXPECT_THAT(SourceOf("leg/spec.json"), HasSubstr("leg/spec.json:1:13: unknown field 'pth' in trem.v1.Source; did you mean 'path'?"));
  EXPECT_THAT(SourceOf("leg/frames", {"tre.ratio=9"}), HasSubstr("tre.ratio is 9; expected a whole number from 2 to 4"));
  EXPECT_THAT(SourceOf(""), HasSubstr("no sortie given"));
}

}  // namespace
}  // namespace trem
