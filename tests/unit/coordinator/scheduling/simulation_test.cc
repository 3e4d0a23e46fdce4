// Goal: no order of faults makes the scheduler lose, repeat or mix up work, and once faults stop every job ends. Method: a few thousand
// seeded worlds (see simulation.h) with a virtual clock. Safety: one commit per key, of its newest attempt; no attempt handed out twice,
// over all lives of the coordinator; never two live leases for a task; the outputs equal those of a run without faults. Liveness: every
// job ends within an hour of virtual time after the last fault. A failure prints its seed; TREM_SIMULATION_SEED=n runs that one alone,
// TREM_SIMULATION_COUNT=n so many of them.
#include "tests/unit/coordinator/scheduling/simulation.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <iostream>

namespace trem::testing {
namespace {

std::uint64_t FromEnvironment(const char* name, std::uint64_t fallback) {
  const char* text = std::getenv(name);
  return text == nullptr ? fallback : std::strtoull(text, nullptr, 10);
}

TEST(SimulationTest, KeepsItsPromisesUnderEveryFault) {
  const bool one = std::getenv("TREM_SIMULATION_SEED") != nullptr;
  const std::uint64_t first = FromEnvironment("TREM_SIMULATION_SEED", 0);
  const std::uint64_t count = one ? 1 : FromEnvironment("TREM_SIMULATION_COUNT", 3'000);
  std::map<std::string, std::uint64_t> faults;
  for (std::uint64_t seed = first; seed < first + count; ++seed) {
    Simulation simulation(seed);
    for (const std::string& violation : simulation.Run()) ADD_FAILURE() << violation;
    for (const auto& [name, times] : simulation.faults().counts) faults[name] += times;
    if (HasFailure()) break;
  }
  if (one) return;
  // A fault that never happened would be untested.
  for (const char* name : {"message lost", "message overtaken", "message late", "message doubled", "worker crashed", "worker hung",
                           "task hung", "worker left", "task failed for now", "task gave up", "result sent twice", "job cancelled",
                           "coordinator died before its log was written", "coordinator died while it sent"}) {
    EXPECT_GT(faults[name], 0U) << name << " never happened";
    RecordProperty(name, std::to_string(faults[name]));
    std::cout << name << ": " << faults[name] << "\n";
  }
}

}  // namespace
}  // namespace trem::testing
