// Goal: folders and globs of images become frames in natural order, grey levels arrive unchanged, colour becomes Rec. 601 luminance, and
// everything that is no readable image is refused by name before memory is spent on it. Method: files written by OpenCV or by hand.
#include "worker/sortie/image_sequence_reader.h"

#include <gtest/gtest.h>

#include <fstream>
#include <opencv2/imgcodecs.hpp>

#include "tests/support/paths.h"

namespace trem {
namespace {

void Write(const std::filesystem::path& path, const cv::Mat& pixels) { ASSERT_TRUE(cv::imwrite(path.string(), pixels)); }

TEST(NaturalLess, ComparesRunsOfDigitsAsNumbers) {
  EXPECT_TRUE(NaturalLess("frame2", "frame10"));
  EXPECT_FALSE(NaturalLess("frame10", "frame2"));
  EXPECT_TRUE(NaturalLess("frame02.png", "frame10.png"));
  EXPECT_TRUE(NaturalLess("a9b2", "a9b10"));
  EXPECT_TRUE(NaturalLess("a", "a1"));
  EXPECT_FALSE(NaturalLess("a1", "a1"));
  EXPECT_NE(NaturalLess("7", "07"), NaturalLess("07", "7"));
  EXPECT_TRUE(NaturalLess("99999999999999999999998", "99999999999999999999999"));
}

TEST(ListImages, ListsAFolderInNaturalOrderWithoutOtherFiles) {
  const testing::TempDir folder;
  for (const char* name : {"f10.png", "f9.PNG", "f1.tif"}) Write(folder / name, cv::Mat(4, 4, CV_8U, cv::Scalar(1)));
  testing::WriteFileContents(folder / "telemetry.csv", "frame\n");
  testing::WriteFileContents(folder / ".hidden.png", "x");
  const auto list = ListImages(folder.path().string());
  ASSERT_TRUE(list.ok()) << list.status().message();
  EXPECT_EQ(list->names, (std::vector<std::string>{"f1.tif", "f9.PNG", "f10.png"}));
  EXPECT_EQ(list->folder, folder.path());
}

TEST(ListImages, ExpandsAGlob) {
  const testing::TempDir folder;
  std::filesystem::create_directories(folder / "run2");
  for (const char* name : {"a1.png", "b1.png", "run2/a2.png"}) Write(folder / name, cv::Mat(4, 4, CV_8U, cv::Scalar(1)));
  const auto list = ListImages((folder / "a*.png").string());
  ASSERT_TRUE(list.ok()) << list.status().message();
  EXPECT_EQ(list->names, std::vector<std::string>{"a1.png"});
  const auto nested = ListImages((folder / "run*/a*.png").string());
  ASSERT_TRUE(nested.ok());
  EXPECT_EQ(nested->folder, folder.path());
  EXPECT_EQ(nested->names, std::vector<std::string>{"run2/a2.png"});
  EXPECT_EQ(ListImages((folder / "c*.png").string()).status().code(), StatusCode::kNotFound);
}

TEST(ListImages, SaysWhatAFolderWithoutImagesHolds) {
  const testing::TempDir folder;
  const auto empty = ListImages(folder.path().string());
  EXPECT_EQ(empty.status().code(), StatusCode::kInvalidInput);
  EXPECT_NE(empty.status().message().find("holds no image (0 other files)"), std::string::npos) << empty.status().message();
  testing::WriteFileContents(folder / "notes.txt", "x");
  EXPECT_NE(ListImages(folder.path().string()).status().message().find("'notes.txt'"), std::string::npos);
  EXPECT_EQ(ListImages((folder / "nothing").string()).status().code(), StatusCode::kNotFound);
}

TEST(ReadGreyImage, KeepsGreyLevelsOf8And16Bits) {
  const testing::TempDir folder;
  cv::Mat small(3, 5, CV_8U);
  cv::Mat deep(3, 5, CV_16U);
  for (int i = 0; i < 15; ++i) {
    small.at<std::uint8_t>(i / 5, i % 5) = static_cast<std::uint8_t>(17 * i);
    deep.at<std::uint16_t>(i / 5, i % 5) = static_cast<std::uint16_t>(4369 * i);
  }
  for (const char* extension : {".png", ".tif"}) {
    Write(folder / (std::string("s") + extension), small);
    Write(folder / (std::string("d") + extension), deep);
    const auto s = ReadGreyImage(folder / (std::string("s") + extension));
    const auto d = ReadGreyImage(folder / (std::string("d") + extension));
    ASSERT_TRUE(s.ok() && d.ok());
    EXPECT_EQ(s->grey_max, 255.0);
    EXPECT_EQ(d->grey_max, 65535.0);
    for (int i = 0; i < 15; ++i) {
      EXPECT_EQ(s->pixels.at(i % 5, i / 5), 17.0F * i);
      EXPECT_EQ(d->pixels.at(i % 5, i / 5), 4369.0F * i);
    }
  }
}

TEST(ReadGreyImage, TurnsColourIntoRec601Luminance) {
  const testing::TempDir folder;
  Write(folder / "c.png", cv::Mat(4, 4, CV_8UC3, cv::Scalar(/*blue=*/30, /*green=*/60, /*red=*/200)));
  Write(folder / "a.png", cv::Mat(4, 4, CV_8UC4, cv::Scalar(30, 60, 200, 128)));
  for (const char* name : {"c.png", "a.png"}) {
    const auto image = ReadGreyImage(folder / name);
    ASSERT_TRUE(image.ok()) << image.status().message();
    EXPECT_NEAR(image->pixels.at(1, 1), 0.299 * 200 + 0.587 * 60 + 0.114 * 30, 1e-3);
  }
}

TEST(ReadGreyImage, ReadsJpegWithinItsLoss) {
  const testing::TempDir folder;
  Write(folder / "j.jpg", cv::Mat(16, 16, CV_8U, cv::Scalar(77)));
  const auto image = ReadGreyImage(folder / "j.jpg");
  ASSERT_TRUE(image.ok());
  EXPECT_NEAR(image->pixels.at(8, 8), 77.0, 1.5);
}

TEST(ReadGreyImage, NamesATextFileThatClaimsToBeAnImage) {
  const testing::TempDir folder;
  testing::WriteFileContents(folder / "x.png", "This is a text.");
  const auto image = ReadGreyImage(folder / "x.png");
  ASSERT_EQ(image.status().code(), StatusCode::kInvalidInput);
  EXPECT_NE(image.status().message().find((folder / "x.png").string() + ": not an image that can be decoded (begins with 'This is a t'"),
            std::string::npos)
      << image.status().message();
  EXPECT_NE(image.status().message().find("expected PNG, TIFF or JPEG"), std::string::npos);
}

TEST(ReadGreyImage, RefusesATruncatedImage) {
  const testing::TempDir folder;
  cv::Mat noise(64, 64, CV_8U);
  cv::randu(noise, 0, 255);
  for (const char* name : {"t.png", "t.jpg", "t.tif"}) {
    Write(folder / name, noise);
    std::filesystem::resize_file(folder / name, std::filesystem::file_size(folder / name) / 2);
    EXPECT_EQ(ReadGreyImage(folder / name).status().code(), StatusCode::kInvalidInput) << name;
  }
}

TEST(ReadGreyImage, RefusesAHugeHeaderBeforeAllocating) {
  const testing::TempDir folder;
  Write(folder / "h.png", cv::Mat(4, 4, CV_8U, cv::Scalar(1)));
  std::string bytes = testing::FileContents(folder / "h.png");
  // IHDR: width and height of 2^27 - 1 pixels, with its checksum (CRC-32 of the chunk) made to fit.
  const std::string ihdr = std::string("IHDR") + std::string("\x07\xff\xff\xff\x07\xff\xff\xff\x08\x00\x00\x00\x00", 13);
  std::uint32_t crc = 0xffffffffU;
  for (const char c : ihdr) {
    crc ^= static_cast<std::uint8_t>(c);
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ ((crc & 1U) != 0 ? 0xedb88320U : 0U);
  }
  crc = ~crc;
  bytes.replace(12, ihdr.size(), ihdr);
  for (int i = 0; i < 4; ++i) bytes[12 + ihdr.size() + static_cast<std::size_t>(i)] = static_cast<char>(crc >> (24 - 8 * i));
  testing::WriteFileContents(folder / "h.png", bytes);
  EXPECT_EQ(ReadGreyImage(folder / "h.png").status().code(), StatusCode::kInvalidInput);
  EXPECT_EQ(ReadGreyImage(folder / "none.png").status().code(), StatusCode::kNotFound);
}

}  // namespace
}  // namespace trem
