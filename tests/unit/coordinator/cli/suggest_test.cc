// Goal: a misspelt word finds the command that was meant, and nonsense finds none. Method: examples.
#include "coordinator/cli/suggest.h"

#include <gtest/gtest.h>

namespace trem {
namespace {

const std::vector<std::string> kCommands = {"run", "inspect", "plan", "submit", "status", "watch"};

TEST(ClosestWord, FindsTheCommandBehindATypingMistake) {
  EXPECT_EQ(ClosestWord("rnu", kCommands), "run");         // Swapped.
  EXPECT_EQ(ClosestWord("inspct", kCommands), "inspect");  // Dropped.
  EXPECT_EQ(ClosestWord("statuss", kCommands), "status");  // Doubled.
  EXPECT_EQ(ClosestWord("wetch", kCommands), "watch");     // Replaced.
}

TEST(ClosestWord, IsEmptyWhenNothingIsClose) {
  EXPECT_EQ(ClosestWord("mosaic", kCommands), "");
  EXPECT_EQ(ClosestWord("", kCommands), "");
  EXPECT_EQ(ClosestWord(std::string(10000, 'x'), kCommands), "");
}

}  // namespace
}  // namespace trem
