// Goal: a chart shows its values where its axes say, and the same chart has the same bytes. Method: decode what was encoded and look for
// the line's colour.
#include "mosaic/publish/line_chart.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <opencv2/imgcodecs.hpp>

namespace trem {
namespace {

LineChart Rising() {
  LineChart chart;
  chart.title = "rising";
  chart.lines = {{"y = x", {0.0, 1.0, 2.0, 3.0, 4.0}, {0.0, 1.0, 2.0, 3.0, 4.0}}};
  return chart;
}

cv::Mat3b Decode(const std::string& png) { return cv::imdecode(std::vector<unsigned char>(png.begin(), png.end()), cv::IMREAD_COLOR); }

// Rows of the plot (below title and legend) where the column has a saturated colour; -1: none.
int ColouredRow(const cv::Mat3b& picture, int column) {
  for (int y = 50; y < picture.rows; ++y) {
    const cv::Vec3b p = picture(y, column);
    if (std::max({p[0], p[1], p[2]}) - std::min({p[0], p[1], p[2]}) > 80) return y;
  }
  return -1;
}

TEST(LineChart, LinesRunFromLowerLeftToUpperRight) {
  const Result<std::string> png = LineChartPng(Rising());
  ASSERT_TRUE(png.ok());
  const cv::Mat3b picture = Decode(*png);
  ASSERT_EQ(picture.cols, 640);
  ASSERT_EQ(picture.rows, 300);
  const int left = ColouredRow(picture, 150);
  const int right = ColouredRow(picture, 550);
  ASSERT_GT(left, 0);
  ASSERT_GT(right, 0);
  // Both axes span 0 .. 4 over 554 x 204 pixels.
  EXPECT_NEAR(left - right, 400 * 204.0 / 554.0, 3.0);
}

TEST(LineChart, ValuesThatAreNotFiniteBreakTheLine) {
  LineChart chart = Rising();
  chart.lines[0].y[2] = std::numeric_limits<double>::quiet_NaN();
  const cv::Mat3b picture = Decode(*LineChartPng(chart));
  EXPECT_GT(ColouredRow(picture, 140), 0);
  EXPECT_EQ(ColouredRow(picture, 70 + 277), -1);
}

// A legend beside the label of the axis would be drawn over it: then it has a row of its own.
TEST(LineChart, ALongLegendStandsBelowTheLabelOfTheAxis) {
  LineChart chart = Rising();
  chart.y_label = "a label";
  chart.lines[0].name = "a name that leaves no room for the label, since it is as wide as the plot itself is";
  const cv::Mat3b picture = Decode(*LineChartPng(chart));
  const auto inked = [&picture](int top, int bottom) {
    int count = 0;
    for (int y = top; y < bottom; ++y) {
      for (int x = 0; x < picture.cols; ++x) count += picture(y, x)[0] < 128 ? 1 : 0;
    }
    return count;
  };
  chart.lines[0].name = "y = x";
  const cv::Mat3b beside = Decode(*LineChartPng(chart));
  EXPECT_GT(inked(46, 66), 200) << "the legend's row";
  int label_changed = 0;
  for (int y = 26; y < 44; ++y) {
    for (int x = 0; x < 60; ++x) label_changed += picture(y, x) != beside(y, x) ? 1 : 0;
  }
  EXPECT_EQ(label_changed, 0) << "the label is drawn over";
}

TEST(LineChart, SameChartSameBytesOtherValuesOtherBytes) {
  LineChart other = Rising();
  other.lines[0].y[1] = 3.5;
  EXPECT_EQ(*LineChartPng(Rising()), *LineChartPng(Rising()));
  EXPECT_NE(*LineChartPng(Rising()), *LineChartPng(other));
}

TEST(LineChart, ConstantLinesHaveAnAxisAndEmptyChartsAreRefused) {
  LineChart flat = Rising();
  flat.lines[0].y.assign(5, 7.0);
  EXPECT_TRUE(LineChartPng(flat).ok());
  flat.lines[0].y.assign(5, std::numeric_limits<double>::infinity());
  EXPECT_FALSE(LineChartPng(flat).ok());
  flat.lines.clear();
  EXPECT_FALSE(LineChartPng(flat).ok());
}

}  // namespace
}  // namespace trem
