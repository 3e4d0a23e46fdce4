// Goal: black borders are found whatever the scene beside them does, and dark ground is not taken for one. Method: moving textures with
// borders of known width drawn over them.
#include "worker/sortie/borders.h"

#include <gtest/gtest.h>

#include "mosaic/base/rng.h"
#include "tests/unit/worker/sortie/test_video.h"

namespace trem {
namespace {

using testing::TexturedFrame;

BorderFinder::Finding FindOver(int frame_count, const std::function<void(int, Image<float>*)>& draw) {
  BorderFinder finder(160, 120);
  for (int i = 0; i < frame_count; ++i) {
    Image<float> frame = TexturedFrame(160, 120, 3.0 * i, 2.0 * i, 8);
    draw(i, &frame);
    finder.Add(frame);
  }
  return finder.Find();
}

void DarkenColumns(Image<float>* frame, int x0, int x1, float factor) {
  for (int y = 0; y < frame->height(); ++y) {
    for (int x = x0; x < x1; ++x) frame->at(x, y) *= factor;
  }
}

TEST(BorderFinder, FindsNothingAroundAFullFrame) {
  const auto finding = FindOver(12, [](int, Image<float>*) {});
  EXPECT_EQ(finding.valid_roi, (Roi{0, 0, 160, 120}));
  EXPECT_EQ(finding.note, "");
}

TEST(BorderFinder, CutsBlackBarsAndTheirFadeWithTwoPixelsMore) {
  const auto finding = FindOver(12, [](int, Image<float>* frame) {
    DarkenColumns(frame, 0, 8, 0.01F);
    DarkenColumns(frame, 8, 9, 0.4F);
    for (int y = 115; y < 120; ++y) std::fill_n(frame->row(y), 160, 1.0F);
  });
  EXPECT_EQ(finding.valid_roi, (Roi{11, 0, 160, 113}));
  EXPECT_EQ(finding.note, "11 columns at the left, 7 rows at the bottom");
}

TEST(BorderFinder, CutsADarkEdgeLine) {
  const auto finding = FindOver(12, [](int, Image<float>* frame) {
    for (int x = 0; x < 160; ++x) frame->at(x, 0) *= 0.4F;
  });
  EXPECT_EQ(finding.valid_roi, (Roi{0, 3, 160, 120}));
}

TEST(BorderFinder, IgnoresAnOddFillerFrame) {
  const auto finding = FindOver(40, [](int i, Image<float>* frame) {
    if (i == 7) {
      *frame = Image<float>(160, 120, 128.0F);
    } else {
      DarkenColumns(frame, 150, 160, 0.0F);
    }
  });
  EXPECT_EQ(finding.valid_roi, (Roi{0, 0, 148, 120}));
}

TEST(BorderFinder, KeepsDarkGroundThatTheCameraPassesOver) {
  const auto finding = FindOver(12, [](int i, Image<float>* frame) {
    if (i < 9) DarkenColumns(frame, 0, 30, 0.05F);
  });
  EXPECT_EQ(finding.valid_roi, (Roi{0, 0, 160, 120}));
}

TEST(BorderFinder, KeepsASmoothShadeTowardsTheEdge) {
  const auto finding = FindOver(12, [](int, Image<float>* frame) {
    for (int x = 0; x < 60; ++x) DarkenColumns(frame, x, x + 1, 0.2F + 0.8F * static_cast<float>(x) / 60.0F);
  });
  EXPECT_EQ(finding.valid_roi, (Roi{0, 0, 160, 120}));
}

}  // namespace
}  // namespace trem
