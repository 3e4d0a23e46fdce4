// Goal: a job on real processes survives kills of every process of the service, stops, damaged artefacts, a full disk and cut links, and
// gives the bytes of an undisturbed run. Method: a short soak (see soak.h); trem_soak runs long ones.
#include "tests/e2e/soak.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iostream>

namespace trem::testing {
namespace {

TEST(SoakTest, GivesTheSameBytesThroughKillsStopsDamageAndAFullDisk) {
  SoakOptions options;
  options.seed = 3;
  options.frame_count = 36;
  options.disturbance_count = 20;
  options.pause_ms_max = 500;
  Soak soak(options);
  EXPECT_THAT(soak.Run(), ::testing::IsEmpty()) << "seed " << options.seed;
  if (!soak.why_no_link().empty()) std::cout << "no link was cut: " << soak.why_no_link() << "\n";
  for (const auto& [what, count] : soak.counts()) std::cout << what << ": " << count << "\n";
  EXPECT_GT(soak.counts().size(), 2U) << "too few kinds of disturbance";
}

}  // namespace
}  // namespace trem::testing
