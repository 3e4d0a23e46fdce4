// Goal: masks and bad pixels of the spec become what is never used, exactly; a file that does not fit is refused by field, file and size.
// Method: small rasters written here; runs there and back on random masks; filling against known surroundings.
#include "worker/sortie/pixel_mask.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <opencv2/imgcodecs.hpp>

#include "mosaic/base/rng.h"
#include "tests/support/paths.h"

namespace trem {
namespace {

using ::testing::HasSubstr;

std::string WriteMask(const std::filesystem::path& path, const cv::Mat& pixels) {
  EXPECT_TRUE(cv::imwrite(path.string(), pixels));
  return path.string();
}

TEST(PixelMask, JoinsTheMaskAndTheBadPixels) {
  const testing::TempDir folder;
  cv::Mat mask(8, 12, CV_8U, cv::Scalar(255));
  mask.colRange(0, 3) = 0;
  cv::Mat bad(8, 12, CV_8U, cv::Scalar(0));
  bad.at<std::uint8_t>(5, 7) = 1;
  bad.at<std::uint8_t>(5, 1) = 1;  // Masked already.
  v1::Sensor sensor;
  sensor.set_mask_path(WriteMask(folder / "mask.png", mask));
  sensor.set_bad_pixel_path(WriteMask(folder / "bad.png", bad));
  const auto found = ReadPixelMask(sensor, 12, 8);
  ASSERT_TRUE(found.ok() && found->has_value()) << found.status().message();
  EXPECT_EQ((*found)->unusable_count, 3 * 8 + 1);
  EXPECT_EQ((*found)->usable.at(7, 5), 0);
  EXPECT_EQ((*found)->usable.at(7, 4), 1);
  EXPECT_EQ((*found)->usable_bounds, (Roi{3, 0, 12, 8}));
}

TEST(PixelMask, RefusesWhatDoesNotFit) {
  const testing::TempDir folder;
  v1::Sensor sensor;
  EXPECT_FALSE(ReadPixelMask(sensor, 12, 8)->has_value());
  sensor.set_mask_path(WriteMask(folder / "mask.png", cv::Mat(8, 11, CV_8U, cv::Scalar(1))));
  const auto small = ReadPixelMask(sensor, 12, 8);
  ASSERT_FALSE(small.ok());
  EXPECT_THAT(small.status().message(), HasSubstr("sensor.mask_path: " + sensor.mask_path() + " is 11 x 8 pixels; expected 12 x 8"));
  sensor.set_mask_path(WriteMask(folder / "none.png", cv::Mat(8, 12, CV_8U, cv::Scalar(0))));
  EXPECT_THAT(ReadPixelMask(sensor, 12, 8).status().message(), HasSubstr("no pixel to use"));
  sensor.set_mask_path(WriteMask(folder / "mask.jpg", cv::Mat(8, 12, CV_8U, cv::Scalar(1))));
  EXPECT_THAT(ReadPixelMask(sensor, 12, 8).status().message(), HasSubstr("JPEG"));
  sensor.set_mask_path((folder / "missing.png").string());
  EXPECT_THAT(ReadPixelMask(sensor, 12, 8).status().message(), HasSubstr("sensor.mask_path"));
}

TEST(PixelMask, RunsLeadBackToTheSameMask) {
  Rng rng({3});
  for (const double part : {0.0, 0.01, 0.5, 1.0}) {
    PixelMask mask;
    mask.usable = Image<std::uint8_t>(37, 21, 1);
    for (std::uint8_t& pixel : mask.usable.pixels()) pixel = rng.Uniform() < part ? 0 : 1;
    const std::vector<std::uint32_t> runs = RunsOf(mask);
    const auto back = UsableFromRuns(runs, 37, 21);
    ASSERT_TRUE(back.ok());
    EXPECT_TRUE(std::equal(back->pixels().begin(), back->pixels().end(), mask.usable.pixels().begin()));
  }
  const std::vector<std::uint32_t> wrong{10, 5};
  EXPECT_EQ(UsableFromRuns(wrong, 4, 4).status().code(), StatusCode::kCorrupt);
  const std::vector<std::uint32_t> huge{4294967295U, 4294967295U};
  EXPECT_EQ(UsableFromRuns(huge, 4, 4).status().code(), StatusCode::kCorrupt);
}

TEST(MaskFiller, FillsWithWhatIsAround) {
  PixelMask mask;
  mask.usable = Image<std::uint8_t>(200, 180, 1);
  mask.usable.at(10, 10) = 0;
  for (int y = 60; y < 120; ++y) {
    for (int x = 100; x < 160; ++x) mask.usable.at(x, y) = 0;
  }
  Image<float> frame(200, 180);
  for (int y = 0; y < 180; ++y) {
    for (int x = 0; x < 200; ++x) frame.at(x, y) = mask.usable.at(x, y) == 0 ? 9999.0F : static_cast<float>(0.5 * x + 0.2 * y);
  }
  MaskFiller(mask).Fill(&frame);
  EXPECT_NEAR(frame.at(10, 10), 7.0, 1e-3);
  EXPECT_NEAR(frame.at(100, 90), 68.0, 3.0) << "at the edge of the hole";
  EXPECT_NEAR(frame.at(130, 90), 83.0, 8.0) << "in its middle";
  EXPECT_EQ(frame.at(99, 59), static_cast<float>(0.5 * 99 + 0.2 * 59)) << "good pixels stay";
}

}  // namespace
}  // namespace trem
