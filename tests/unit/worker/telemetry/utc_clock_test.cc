// Protects: a mosaic's date is that of its telemetry, between, before and after records, and none is made up where telemetry tells none.
#include "worker/telemetry/utc_clock.h"

#include <gtest/gtest.h>

#include <limits>

namespace trem {
namespace {

constexpr std::int64_t kStart_us = 1'245'257'585'000'000;

TelemetryRecord At(double time_s, std::optional<std::int64_t> utc_us) {
  TelemetryRecord record;
  record.time_s = time_s;
  record.utc_us = utc_us;
  return record;
}

TEST(UtcClock, IsLinearBetweenRecordsAndRunsOnBeyondThem) {
  // A stamp of 2 s in 1 s: the multiplexer's clock need not be that of the stamps.
  const UtcClock clock({At(10.0, kStart_us), At(10.5, std::nullopt), At(11.0, kStart_us + 2'000'000)});
  EXPECT_EQ(clock.At(10.0), kStart_us);
  EXPECT_EQ(clock.At(10.25), kStart_us + 500'000);
  EXPECT_EQ(clock.At(11.0), kStart_us + 2'000'000);
  EXPECT_EQ(clock.At(9.0), kStart_us - 1'000'000);
  EXPECT_EQ(clock.At(11.5), kStart_us + 2'500'000);
}

TEST(UtcClock, KnowsNothingWithoutRecordsThatTellATime) {
  EXPECT_EQ(UtcClock().At(0.0), std::nullopt);
  EXPECT_EQ(UtcClock({At(0.0, std::nullopt)}).At(0.0), std::nullopt);
  // Counted from the start of the recording; beyond the year 9999.
  EXPECT_EQ(UtcClock({At(0.0, 5'000'000), At(1.0, 6'000'000)}).At(0.5), std::nullopt);
  EXPECT_EQ(UtcClock({At(0.0, kUtcMost_us + 1)}).At(0.0), std::nullopt);
}

TEST(UtcClock, DoesNotBelieveTimesThatRunBackward) {
  EXPECT_EQ(UtcClock({At(0.0, kStart_us), At(1.0, kStart_us + 1), At(2.0, kStart_us)}).At(0.0), std::nullopt);
}

TEST(UtcClock, SaysNothingOfTimesThatAreNoneOrDaysAway) {
  const UtcClock clock({At(0.0, kStart_us)});
  EXPECT_EQ(clock.At(std::numeric_limits<double>::quiet_NaN()), std::nullopt);
  EXPECT_EQ(clock.At(1e300), std::nullopt);
  EXPECT_EQ(clock.At(-1e5), std::nullopt);
}

}  // namespace
}  // namespace trem
