// Goal: digests are those that the rest of the world computes, of files of any length, and files are read and written where they should
// be. Method: published values (FIPS 180-2, xxHash's own test of the empty input), and blocks whose ends lie around the sizes of buffers.
#include "mosaic/base/digest.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "mosaic/base/open_file.h"
#include "tests/support/paths.h"

namespace trem {
namespace {

using ::testing::HasSubstr;

TEST(Digest, GivesPublishedValues) {
  EXPECT_EQ(Sha256Hex(""), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  EXPECT_EQ(Sha256Hex("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
  EXPECT_EQ(Xxh3(""), 0x2d06800538d394c2ULL);
}

TEST(Digest, OfAFileIsThatOfItsBytes) {
  const testing::TempDir folder;
  constexpr std::size_t kBlock = std::size_t{256} << 10;
  for (const std::size_t bytes : {std::size_t{0}, std::size_t{1}, kBlock - 1, kBlock, kBlock + 1, 3 * kBlock + 5}) {
    std::string content(bytes, 'x');
    if (bytes > 0) content.back() = 'y';
    testing::WriteFileContents(folder / "file", content);
    EXPECT_EQ(Sha256HexOfFile(folder / "file").value(), Sha256Hex(content)) << bytes;
  }
  EXPECT_EQ(Sha256HexOfFile(folder / "missing").status().code(), StatusCode::kNotFound);
  EXPECT_FALSE(Sha256HexOfFile(folder.path()).ok());
}

TEST(OpenFile, ReadsAndWritesWhereItIsTold) {
  const testing::TempDir folder;
  const OpenFile file = OpenFile::Open(folder / "file", O_RDWR | O_CREAT).value();
  ASSERT_TRUE(file.WriteAt(4, "later").ok());
  ASSERT_TRUE(file.WriteAt(0, "soon").ok());
  EXPECT_EQ(file.Size().value(), 9U);
  std::string read(6, ' ');
  ASSERT_TRUE(file.ReadAt(2, read).ok());
  EXPECT_EQ(read, "onlate");
  const Status beyond = file.ReadAt(5, read);
  EXPECT_EQ(beyond.code(), StatusCode::kCorrupt);
  EXPECT_THAT(beyond.message(), HasSubstr("became shorter"));
}

}  // namespace
}  // namespace trem
