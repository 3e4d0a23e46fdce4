// Goal: images of any size hold what is written to them, whichever way their memory was come by, and absurd sizes are refused.
// Method: images on either side of the bound from which large pages are asked for are filled, copied, moved and compared; blocks are
// looked at by their addresses.
#include "mosaic/base/large_pages.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <numeric>
#include <utility>
#include <vector>

#include "mosaic/base/image.h"

namespace trem {
namespace {

TEST(LargePages, ImagesOnEitherSideOfTheBoundHoldWhatIsWritten) {
  const int at_bound = static_cast<int>(kLargePagesFrom / sizeof(std::uint32_t));
  for (const int cells : {1, at_bound - 1, at_bound, at_bound + 1, 5 * at_bound / 2}) {
    Image<std::uint32_t> image(cells, 1);
    EXPECT_EQ(image.at(cells - 1, 0), 0U) << cells;
    std::iota(image.pixels().begin(), image.pixels().end(), 7U);
    Image<std::uint32_t> copy = image;
    const Image<std::uint32_t> moved = std::move(image);
    copy.at(0, 0) = 1;
    EXPECT_EQ(moved.at(0, 0), 7U) << cells << ": a copy is not the original";
    for (int x = 1; x < cells; x += 997) ASSERT_EQ(copy.at(x, 0), 7U + static_cast<unsigned>(x)) << cells;
    EXPECT_EQ(moved.at(cells - 1, 0), 6U + static_cast<unsigned>(cells));
  }
}

TEST(LargePages, BlocksBeginAtCacheLines) {
  std::vector<void*> blocks;
  for (int k = 0; k < 30; ++k) {
    blocks.push_back(AllocateLarge(kLargePagesFrom + static_cast<std::size_t>(k)));
    EXPECT_EQ(reinterpret_cast<std::uintptr_t>(blocks.back()) % 64, 0U);
  }
  for (void* block : blocks) FreeLarge(block);
}

TEST(LargePages, AbsurdSizesAreRefused) {
  EXPECT_THROW((void)AllocateLarge(SIZE_MAX - 100), std::bad_alloc);
  EXPECT_THROW((void)LargePageAllocator<double>().allocate(SIZE_MAX / 4), std::bad_array_new_length);
}

}  // namespace
}  // namespace trem
