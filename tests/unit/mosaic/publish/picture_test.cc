// Goal: reduced pictures show the mosaic, transparent where nothing was seen. Method: brute-force block means, decode what was encoded.
#include "mosaic/publish/picture.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <opencv2/imgcodecs.hpp>

#include "mosaic/base/rng.h"

namespace trem {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

cv::Mat Decode(const std::string& png) { return cv::imdecode(std::vector<unsigned char>(png.begin(), png.end()), cv::IMREAD_UNCHANGED); }

TEST(Reduction, IsTheMeanOfTheFiniteValuesOfEachBlockHoweverItArrives) {
  Rng rng({1});
  Image<float> whole(103, 57);
  for (float& value : whole.pixels()) value = rng.Uniform() < 0.4 ? kNan : static_cast<float>(rng.Uniform());
  Reduction reduction(103, 57, 30);
  ASSERT_EQ(reduction.factor(), 4);
  for (int y0 = 0; y0 < 57; y0 += 10) {
    for (int x0 = 0; x0 < 103; x0 += 30) {
      const Roi roi = Intersect({x0, y0, x0 + 30, y0 + 10}, {0, 0, 103, 57});
      Image<float> part(roi.width(), roi.height());
      for (int y = roi.y0; y < roi.y1; ++y) {
        for (int x = roi.x0; x < roi.x1; ++x) part.at(x - roi.x0, y - roi.y0) = whole.at(x, y);
      }
      reduction.Add(roi, part);
    }
  }
  const Image<float> picture = reduction.Picture();
  ASSERT_EQ(picture.width(), 26);
  ASSERT_EQ(picture.height(), 15);
  for (int row = 0; row < 15; ++row) {
    for (int column = 0; column < 26; ++column) {
      double sum = 0.0;
      int count = 0;
      for (int y = 4 * row; y < std::min(4 * row + 4, 57); ++y) {
        for (int x = 4 * column; x < std::min(4 * column + 4, 103); ++x) {
          if (std::isnan(whole.at(x, y))) continue;
          sum += whole.at(x, y);
          ++count;
        }
      }
      ASSERT_EQ(std::isnan(picture.at(column, row)), count == 0);
      if (count == 0) continue;
      ASSERT_NEAR(picture.at(column, row), sum / count, 1e-6);
    }
  }
}

TEST(Picture, GreyGoesFromBlackToWhiteAndIsTransparentWhereNothingWasSeen) {
  Image<float> picture(4, 1);
  picture.at(0, 0) = 10.0f;
  picture.at(1, 0) = 15.0f;
  picture.at(2, 0) = 30.0f;
  picture.at(3, 0) = kNan;
  const auto png = GreyPng(picture, {10.0, 20.0});
  ASSERT_TRUE(png.ok());
  const cv::Mat decoded = Decode(*png);
  ASSERT_EQ(decoded.type(), CV_8UC4);
  EXPECT_EQ(decoded.at<cv::Vec4b>(0, 0), cv::Vec4b(0, 0, 0, 255));
  EXPECT_EQ(decoded.at<cv::Vec4b>(0, 1), cv::Vec4b(128, 128, 128, 255));
  EXPECT_EQ(decoded.at<cv::Vec4b>(0, 2), cv::Vec4b(255, 255, 255, 255));
  EXPECT_EQ(decoded.at<cv::Vec4b>(0, 3), cv::Vec4b(128, 128, 128, 0));
  const cv::Mat colour = Decode(*ColourPng(picture, {10.0, 20.0}));
  EXPECT_EQ(colour.at<cv::Vec4b>(0, 3)[3], 0);
  EXPECT_GT(colour.at<cv::Vec4b>(0, 0)[0], colour.at<cv::Vec4b>(0, 2)[0]) << "low is blue, high is yellow";
}

TEST(Picture, QuantilesIgnoreWhatWasNotSeen) {
  Image<float> picture(1001, 2, kNan);
  for (int x = 0; x <= 1000; ++x) picture.at(x, 1) = static_cast<float>(1000 - x);
  const ValueRange range = QuantileRange(picture, 0.01, 0.9);
  EXPECT_EQ(range.low, 10.0);
  EXPECT_EQ(range.high, 900.0);
  const ValueRange nothing = QuantileRange(Image<float>(3, 3, kNan), 0.01, 0.99);
  EXPECT_LT(nothing.low, nothing.high);
  const ValueRange flat = QuantileRange(Image<float>(3, 3, 7.0f), 0.01, 0.99);
  EXPECT_LT(flat.low, flat.high);
}

TEST(Picture, Base64MatchesTheTestVectorsOfRfc4648) {
  EXPECT_EQ(Base64(""), "");
  EXPECT_EQ(Base64("f"), "Zg==");
  EXPECT_EQ(Base64("fo"), "Zm8=");
  EXPECT_EQ(Base64("foo"), "Zm9v");
  EXPECT_EQ(Base64("foob"), "Zm9vYg==");
  EXPECT_EQ(Base64("fooba"), "Zm9vYmE=");
  EXPECT_EQ(Base64("foobar"), "Zm9vYmFy");
  EXPECT_EQ(Base64("\xff\xfe\xfd"), "//79");
}

}  // namespace
}  // namespace trem
