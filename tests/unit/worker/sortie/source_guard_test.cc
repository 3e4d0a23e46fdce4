// Goal: a worker that was given folders reads nothing outside them, whatever path a spec names. Method: every trick in a temporary folder:
// dots, links as file, folder, frame and telemetry, globs, neighbours with the same beginning, GDAL's virtual paths.
#include "worker/sortie/source_guard.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "mosaic/base/digest.h"
#include "proto/codec/upload.h"
#include "tests/support/paths.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class SourceGuardTest : public ::testing::Test {
 protected:
  SourceGuardTest() {
    for (const char* name : {"open/leg", "open-too", "secret"}) fs::create_directories(folder_ / name);
    for (const char* name : {"open/leg/1.png", "open/kernel.txt", "open-too/1.png", "secret/1.png", "secret/telemetry.csv"}) {
      testing::WriteFileContents(folder_ / name, "x");
    }
    guard_ = SourceGuard::Make({(folder_ / "open").string(), "/vsis3/flights"}, true).value();
  }
  Status Check(const fs::path& source) const {
    v1::Sortie sortie;
    sortie.mutable_source()->set_path(source.string());
    return guard_.Check(sortie);
  }

  testing::TempDir folder_;
  SourceGuard guard_;
};

TEST_F(SourceGuardTest, AllowsWhatLiesBelowItsFolders) {
  for (const char* path : {"open/leg", "open/leg/1.png", "open/leg/*.png", "open/*/1.png", "open/leg/../leg", "open/missing.ts"}) {
    EXPECT_TRUE(Check(folder_ / path).ok()) << path << ": " << Check(folder_ / path).message();
  }
  fs::create_symlink(folder_ / "open/leg", folder_ / "open/link");
  EXPECT_TRUE(Check(folder_ / "open/link").ok());
  EXPECT_TRUE(Check("/vsis3/flights/leg.ts").ok());
}

TEST_F(SourceGuardTest, RefusesWhatLiesOutside) {
  for (const char* path : {"secret", "secret/1.png", "secret/*.png", "open/../secret", "open/leg/../../secret/1.png", "open-too", "*/1.png",
                           "open/../*/1.png", ""}) {
    const Status status = Check(folder_ / path);
    EXPECT_EQ(status.code(), StatusCode::kInvalidInput) << path;
  }
  for (const char* path : {"/etc/passwd", "/vsis3/flights-of-others/leg.ts", "/vsis3/flights/../other/leg.ts", "/vsicurl/http://10.0.0.1/x",
                           "/vsizip//etc/x.zip", "/vsizip//vsis3/flights/x.zip", "relative"}) {
    EXPECT_FALSE(Check(path).ok()) << path;
  }
}

TEST_F(SourceGuardTest, ChecksEveryRecordingAsASourceOfItsOwn) {
  v1::Sortie sortie;
  sortie.mutable_source()->set_path((folder_ / "open/leg").string());
  v1::Source* more = sortie.add_more()->mutable_source();
  more->set_path((folder_ / "open/leg").string());
  EXPECT_TRUE(guard_.Check(sortie).ok()) << guard_.Check(sortie).message();
  for (const char* path : {"secret", "secret/*.png", "*/1.png"}) {
    more->set_path((folder_ / path).string());
    EXPECT_EQ(guard_.Check(sortie).code(), StatusCode::kInvalidInput) << path;
  }
}

TEST_F(SourceGuardTest, FollowsLinksBeforeItJudges) {
  fs::create_symlink(folder_ / "secret", folder_ / "open/folder");
  fs::create_symlink(folder_ / "secret/1.png", folder_ / "open/file.ts");
  for (const char* path : {"open/folder", "open/folder/1.png", "open/folder/*.png", "open/*/1.png", "open/file.ts", "open/folder/new.ts"}) {
    EXPECT_FALSE(Check(folder_ / path).ok()) << path;
  }
  EXPECT_TRUE(Check(folder_ / "open/leg").ok());
  fs::create_symlink(folder_ / "secret/1.png", folder_ / "open/leg/2.png");
  EXPECT_THAT(Check(folder_ / "open/leg").message(), HasSubstr("2.png"));
  fs::remove(folder_ / "open/leg/2.png");
  fs::create_symlink(folder_ / "secret/telemetry.csv", folder_ / "open/telemetry.csv");
  EXPECT_THAT(Check(folder_ / "open/leg").message(), HasSubstr("telemetry"));
}

TEST_F(SourceGuardTest, ChecksEveryPathOfTheSpec) {
  const std::string secret = (folder_ / "secret/1.png").string();
  for (int field = 0; field < 8; ++field) {
    v1::Sortie sortie;
    sortie.mutable_source()->set_path((folder_ / "open/leg").string());
    if (field == 1) sortie.mutable_telemetry()->set_path(secret);
    if (field == 2) sortie.mutable_sensor()->set_psf_kernel_path(secret);
    if (field == 3) sortie.mutable_sensor()->set_bad_pixel_path(secret);
    if (field == 4) sortie.mutable_sensor()->set_mask_path(secret);
    if (field == 5) sortie.mutable_telemetry()->set_dem_path(secret);
    if (field == 6) sortie.mutable_control()->set_path(secret);
    if (field == 7) sortie.mutable_mosaic()->set_cutline_path(secret);
    EXPECT_EQ(guard_.Check(sortie).ok(), field == 0) << field;
  }
}

TEST_F(SourceGuardTest, AnUploadMayBeReadButLeadsNowhereElse) {
  const std::string upload = UploadName({"upload.pb", Sha256Hex("list"), 100});
  EXPECT_TRUE(Check(upload + "/leg.ts").ok());
  EXPECT_FALSE(Check(upload + "/../../secret/1.png").ok());
  EXPECT_FALSE(Check("/" + upload + "/leg.ts").ok());
  v1::Sortie sortie;
  sortie.mutable_source()->set_path(upload + "/leg.ts");
  sortie.mutable_telemetry()->set_dem_path((folder_ / "secret/1.png").string());
  EXPECT_THAT(guard_.Check(sortie).message(), HasSubstr("telemetry.dem_path"));
  EXPECT_FALSE(SourceGuard::Make({}, true).value().Check(sortie).ok());
  sortie.mutable_telemetry()->set_dem_path(upload + "/named/telemetry.dem_path/dem.tif");
  EXPECT_TRUE(SourceGuard::Make({}, true).value().Check(sortie).ok());
}

TEST_F(SourceGuardTest, WithoutFoldersAllIsOpenOrClosed) {
  v1::Sortie sortie;
  sortie.mutable_source()->set_path((folder_ / "secret").string());
  EXPECT_TRUE(SourceGuard::Make({}, false).value().Check(sortie).ok());
  EXPECT_THAT(SourceGuard::Make({}, true).value().Check(sortie).message(), HasSubstr("without --source-root"));
  EXPECT_FALSE(SourceGuard::Make({(folder_ / "nowhere").string()}, true).ok());
}

}  // namespace
}  // namespace trem
