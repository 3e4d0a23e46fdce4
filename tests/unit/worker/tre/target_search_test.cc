// Goal: a picture is found where it is, under gain and offset, with holes in picture and frame, and nothing is found where there is nothing
// to compare. Method: crops of a procedural frame.
#include "worker/tre/target_search.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "tests/support/rendered_sequence.h"

namespace trem {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

Image<float> CropOf(const Image<float>& frame, int x0, int y0, int width, int height) {
  Image<float> crop(width, height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) crop.at(x, y) = frame.at(x0 + x, y0 + y);
  }
  return crop;
}

TEST(TargetSearch, FindsAPictureUnderGainOffsetAndHoles) {
  Image<float> frame = testing::ProceduralTruth(160, 120, 5);
  Image<float> picture = CropOf(frame, 71, 33, 24, 20);
  for (float& value : picture.pixels()) value = 0.7F * value + 21.0F;
  for (int i = 0; i < 6; ++i) picture.at(i, 0) = kNan;
  frame.at(10, 10) = kNan;
  const std::vector<Sighting> found = FindPicture(picture, frame, 3);
  ASSERT_FALSE(found.empty());
  EXPECT_EQ(found[0].x, 71);
  EXPECT_EQ(found[0].y, 33);
  EXPECT_GT(found[0].correlation, 0.999);
  for (std::size_t k = 1; k < found.size(); ++k) {
    EXPECT_LT(found[k].correlation, 0.95);
    EXPECT_TRUE(std::abs(found[k].x - 71) > 12 || std::abs(found[k].y - 33) > 10) << "places are half a picture apart";
  }
}

TEST(TargetSearch, FindsNothingWithoutTextureOrRoom) {
  const Image<float> frame = testing::ProceduralTruth(60, 50, 5);
  EXPECT_TRUE(FindPicture(Image<float>(20, 20, 90.0F), frame, 3).empty());
  EXPECT_TRUE(FindPicture(Image<float>(20, 20, kNan), frame, 3).empty());
  EXPECT_TRUE(FindPicture(testing::ProceduralTruth(61, 20, 6), frame, 3).empty());
  EXPECT_TRUE(FindPicture(CropOf(frame, 5, 5, 20, 20), Image<float>(60, 50, 90.0F), 3).empty()) << "a flat frame holds no picture";
}

}  // namespace
}  // namespace trem
