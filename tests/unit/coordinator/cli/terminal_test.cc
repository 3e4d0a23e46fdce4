// Goal: numbers are printed as people read them and every status has its documented exit code. Method: examples at the unit borders.
#include "coordinator/cli/terminal.h"

#include <gtest/gtest.h>

namespace trem {
namespace {

TEST(FormatBytes, ChoosesTheUnitThatKeepsThreeDigits) {
  EXPECT_EQ(FormatBytes(0), "0 B");
  EXPECT_EQ(FormatBytes(999), "999 B");
  EXPECT_EQ(FormatBytes(1000), "1.0 kB");
  EXPECT_EQ(FormatBytes(999949), "999.9 kB");
  EXPECT_EQ(FormatBytes(999951), "1.0 MB");
  EXPECT_EQ(FormatBytes(12.3e9), "12.3 GB");
}

TEST(FormatDuration, PadsSecondsAndMinutes) {
  EXPECT_EQ(FormatDuration(-1), "0:00");
  EXPECT_EQ(FormatDuration(6.6), "0:07");
  EXPECT_EQ(FormatDuration(59.6), "1:00");
  EXPECT_EQ(FormatDuration(3723), "1:02:03");
}

TEST(ExitCodeOf, FollowsTheDocumentedTable) {
  EXPECT_EQ(ExitCodeOf(StatusCode::kOk), 0);
  EXPECT_EQ(ExitCodeOf(StatusCode::kInvalidInput), 3);
  EXPECT_EQ(ExitCodeOf(StatusCode::kNotFound), 3);
  EXPECT_EQ(ExitCodeOf(StatusCode::kUnavailable), 4);
  EXPECT_EQ(ExitCodeOf(StatusCode::kExhausted), 1);
  EXPECT_EQ(ExitCodeOf(StatusCode::kCancelled), 1);
  EXPECT_EQ(ExitCodeOf(StatusCode::kCorrupt), 1);
  EXPECT_EQ(ExitCodeOf(StatusCode::kFailed), 1);
}

}  // namespace
}  // namespace trem
