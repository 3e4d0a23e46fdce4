// Goal: paths lead into an upload or are no upload's, and no list of files leads out of its folder. Method: the good forms, and every
// trick.
#include "proto/codec/upload.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "mosaic/base/digest.h"

namespace trem {
namespace {

TEST(UploadTest, ReadsWhatItNames) {
  const ArtefactRef list{"upload.pb", Sha256Hex("list"), 12345};
  const auto found = UploadOfPath(UploadName(list) + "/frames/0001.png");
  ASSERT_TRUE(found.has_value());
  EXPECT_EQ(found->sha256, list.sha256);
  EXPECT_EQ(found->bytes, 12345U);
  EXPECT_TRUE(UploadOfPath(UploadName(list)).has_value());
}

TEST(UploadTest, TakesNothingElseForAnUpload) {
  const std::string name = UploadName({"upload.pb", Sha256Hex("list"), 12345});
  for (const std::string& path :
       {std::string(), std::string("/etc/passwd"), "/" + name, name + "/", name + "/../x", name + "/./x", name + "//x", name + "x/y",
        "upload-" + Sha256Hex("list"), "upload-" + Sha256Hex("list") + "-", name.substr(1), "upload-" + std::string(64, 'G') + "-1",
        "upload-" + std::string(64, '.') + "-1", name + "-1", name + std::string("/a\0b", 4), name + "/" + std::string(5000, 'a'),
        name + "99999999999999999999"}) {
    EXPECT_FALSE(UploadOfPath(path).has_value()) << path;
  }
}

TEST(UploadTest, RefusesListsThatLeadOutside) {
  const auto check = [](const std::vector<std::string>& names) {
    v1::UploadList list;
    for (const std::string& name : names) {
      list.add_files()->set_name(name);
      list.mutable_files(list.files_size() - 1)->set_sha256(Sha256Hex(name));
    }
    return CheckUploadList(list).ok();
  };
  EXPECT_TRUE(check({}));
  EXPECT_TRUE(check({"leg.ts", "frames/0001.png", "telemetry/telemetry.csv", "..a/b..", ".hidden"}));
  for (const char* name : {"", "/etc/passwd", "../x", "a/../b", "a/..", "./a", "a//b", "a/", "."}) EXPECT_FALSE(check({name})) << name;
  EXPECT_FALSE(check({"a", "b", "a"}));
  v1::UploadList undigested;
  undigested.add_files()->set_name("a");
  EXPECT_FALSE(CheckUploadList(undigested).ok());
}

}  // namespace
}  // namespace trem
