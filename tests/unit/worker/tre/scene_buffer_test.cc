// Goal: the buffer moves over the scene plane by whole cells and loses nothing that stays in it. Method: cells hold a number that names
// their place in the plane.
#include "worker/tre/scene_buffer.h"

#include <gtest/gtest.h>

namespace trem {
namespace {

float NameOf(int x, int y) { return static_cast<float>(1000 * (x + 50) + (y + 50)); }

TEST(SceneBuffer, MoveToKeepsWhatStaysAndClearsWhatComesIn) {
  const Roi before{-10, 5, 20, 25};
  for (const Roi& after : {Roi{-10, 5, 20, 25}, Roi{-4, 0, 33, 19}, Roi{-30, -30, 40, 40}, Roi{0, 10, 5, 12}, Roi{100, 100, 120, 110}}) {
    SceneBuffer buffer(before);
    Image<float>* const planes[] = {&buffer.scene,      &buffer.previous, &buffer.weight,    &buffer.weighted,
                                    &buffer.prediction, &buffer.filled,   &buffer.majoriser, &buffer.seen};
    for (std::size_t k = 0; k < 6; ++k) {
      for (int y = 0; y < before.height(); ++y) {
        for (int x = 0; x < before.width(); ++x) {
          planes[k]->at(x, y) = NameOf(before.x0 + x, before.y0 + y) + static_cast<float>(k) * 1e5F;
        }
      }
    }
    buffer.MoveTo(after);
    EXPECT_EQ(buffer.extent, after);
    for (std::size_t k = 0; k < 6; ++k) {
      ASSERT_EQ(planes[k]->width(), after.width());
      ASSERT_EQ(planes[k]->height(), after.height());
      for (int y = 0; y < after.height(); ++y) {
        for (int x = 0; x < after.width(); ++x) {
          const bool kept = before.Contains(after.x0 + x, after.y0 + y);
          const float expected = kept ? NameOf(after.x0 + x, after.y0 + y) + static_cast<float>(k) * 1e5F : 0.0F;
          ASSERT_EQ(planes[k]->at(x, y), expected) << ToString(after) << " plane " << k;
        }
      }
    }
  }
}

TEST(SceneBuffer, InBufferClipsToTheBuffer) {
  const SceneBuffer buffer(Roi{-10, 5, 20, 25});
  EXPECT_EQ(buffer.InBuffer({-12, 7, 0, 100}), (Roi{0, 2, 10, 20}));
  EXPECT_TRUE(buffer.InBuffer({30, 5, 40, 25}).empty());
}

}  // namespace
}  // namespace trem
