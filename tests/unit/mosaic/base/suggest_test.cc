// Goal: a misspelt word finds the name that was meant, and nonsense finds none. Method: examples of each kind of typing mistake.
#include "mosaic/base/suggest.h"

#include <gtest/gtest.h>

namespace trem {
namespace {

const std::vector<std::string> kCommands = {"run", "inspect", "plan", "submit", "status", "watch"};

TEST(DidYouMean, FindsTheNameBehindATypingMistake) {
  EXPECT_EQ(DidYouMean("rnu", kCommands), "; did you mean 'run'?");         // Swapped.
  EXPECT_EQ(DidYouMean("inspct", kCommands), "; did you mean 'inspect'?");  // Dropped.
  EXPECT_EQ(DidYouMean("statuss", kCommands), "; did you mean 'status'?");  // Doubled.
  EXPECT_EQ(DidYouMean("wetch", kCommands), "; did you mean 'watch'?");     // Replaced.
  EXPECT_EQ(DidYouMean("PLAN", kCommands), "; did you mean 'plan'?");       // Capitals.
}

TEST(DidYouMean, IsEmptyWhenNothingIsNear) {
  EXPECT_EQ(DidYouMean("mosaic", kCommands), "");
  EXPECT_EQ(DidYouMean("", kCommands), "");
  EXPECT_EQ(DidYouMean(std::string(10000, 'x'), kCommands), "");
  EXPECT_EQ(DidYouMean("run", {}), "");
}

}  // namespace
}  // namespace trem
