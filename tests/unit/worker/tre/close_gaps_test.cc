#include "worker/tre/close_gaps.h"

#include <gtest/gtest.h>

#include <algorithm>

namespace trem {
namespace {

// A standing camera leaves no hatching in a snapshot, and none is added beyond what was seen.
TEST(CloseGaps, ClosesWhatIsNarrowerThanASensorPixelAndNothingElse) {
  Image<float> seen(12, 9);
  for (int y = 2; y < 7; ++y) {
    for (int x = 1; x < 11; ++x) seen.at(x, y) = 4.0F;
  }
  const Image<float> whole = seen;
  for (int y = 2; y < 7; ++y) {
    seen.at(3, y) = 0.0F;                    // A line of one cell, ...
    seen.at(5, y) = seen.at(6, y) = 0.1F;    // ... one of two, ...
  }
  const Image<float> closed = CloseGaps(seen, 0.4F, 3);
  EXPECT_TRUE(std::ranges::equal(closed.pixels(), whole.pixels()));
  for (int y = 2; y < 7; ++y) seen.at(7, y) = 0.0F;  // ... and one of three.
  EXPECT_EQ(CloseGaps(seen, 0.4F, 3).at(6, 4), 0.1F);
}

}  // namespace
}  // namespace trem
