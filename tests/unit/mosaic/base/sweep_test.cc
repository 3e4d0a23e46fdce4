// Goal: a sweep takes only what is old enough and nobody's. Method: every combination of age, use and release; digests packed and unpacked.
#include "mosaic/base/sweep.h"

#include <gtest/gtest.h>

namespace trem {
namespace {

using std::chrono::hours;
using std::chrono::seconds;

const std::string kUsed(64, 'a');
const std::string kReleased(64, 'b');
const std::string kNobodys(64, 'c');

TEST(SweepRule, TakesOnlyWhatIsOldEnoughAndNobodys) {
  // Lists need not be sorted, and what was released may be in use again.
  const SweepRule rule({kUsed, std::string(64, '0'), kUsed}, {kReleased, kUsed}, {});
  EXPECT_FALSE(rule.MayGo(kUsed, hours(1000)));
  EXPECT_TRUE(rule.MayGo(kNobodys, hours(24)));
  EXPECT_FALSE(rule.MayGo(kNobodys, hours(24) - seconds(1)));
  EXPECT_TRUE(rule.MayGo(kReleased, seconds(60)));
  EXPECT_FALSE(rule.MayGo(kReleased, seconds(59)));
  EXPECT_FALSE(rule.MayGo(kNobodys, seconds(-100)));
}

TEST(PackDigests, AreUnpackedToTheSame) {
  const std::vector<std::string> digests = {kUsed, "0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef", kNobodys};
  const std::string bytes = PackDigests(digests);
  EXPECT_EQ(bytes.size(), 96U);
  EXPECT_EQ(UnpackDigests(bytes).value(), digests);
  EXPECT_TRUE(UnpackDigests("").value().empty());
  EXPECT_EQ(UnpackDigests(bytes.substr(1)).status().code(), StatusCode::kCorrupt);
}

}  // namespace
}  // namespace trem
