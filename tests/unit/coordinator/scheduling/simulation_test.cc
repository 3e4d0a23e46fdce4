// Goal: no order of faults makes the scheduler lose, repeat or mix up work, and once faults stop every job ends. Method: ten thousand
// seeded worlds (see simulation.h) with a virtual clock. Safety (see checker.h): one commit per key, of a leased or the newest attempt; no
// attempt handed out twice, over all lives of the coordinator; one live lease a task, two when the second is written down as a hedge;
// nothing acknowledged that is not in the log; no worker given more than its credit and memory, no user more than the limit; a removed job
// stays removed, and what a finished job has is not forgotten with another; the outputs equal those of a run without
// faults. Liveness: every job ends within half an hour of virtual time after the last fault. A failure prints its seed;
// TREM_SIMULATION_SEED=n runs that one alone, TREM_SIMULATION_COUNT=n so many of them.
//
// That the simulation would notice: each planted fault (coordinator/scheduling/planted_fault.h, and two of the simulated shell) breaks one
// rule, and some seed among the first few hundred must fail.
#include "tests/unit/coordinator/scheduling/simulation.h"

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <exception>
#include <iostream>

#include "coordinator/scheduling/planted_fault.h"

namespace trem::testing {
namespace {

std::uint64_t FromEnvironment(const char* name, std::uint64_t fallback) {
  const char* text = std::getenv(name);
  return text == nullptr ? fallback : std::strtoull(text, nullptr, 10);
}

TEST(SimulationTest, KeepsItsPromisesUnderEveryFault) {
  const bool one = std::getenv("TREM_SIMULATION_SEED") != nullptr;
  const std::uint64_t first = FromEnvironment("TREM_SIMULATION_SEED", 0);
  const std::uint64_t count = one ? 1 : FromEnvironment("TREM_SIMULATION_COUNT", 10'000);
  std::map<std::string, std::uint64_t> faults;
  for (std::uint64_t seed = first; seed < first + count; ++seed) {
    Simulation simulation(seed);
    for (const std::string& violation : simulation.Run()) ADD_FAILURE() << violation;
    for (const auto& [name, times] : simulation.faults().counts) faults[name] += times;
    if (HasFailure()) break;
  }
  if (one) return;
  // A fault that never happened would be untested.
  for (const char* name : {"message lost",
                           "message overtaken",
                           "message late",
                           "message doubled",
                           "link cut",
                           "worker crashed",
                           "worker hung",
                           "task hung",
                           "worker left",
                           "worker drained",
                           "task failed for now",
                           "task gave up",
                           "result sent twice",
                           "artefact damaged",
                           "job cancelled",
                           "job ended in part",
                           "job removed",
                           "job submitted again",
                           "disk slow",
                           "disk full",
                           "log compacted",
                           "coordinator stopped",
                           "coordinator died before its log was written",
                           "coordinator died while it wrote its log",
                           "coordinator died while it sent"}) {
    EXPECT_GT(faults[name], 0U) << name << " never happened";
    std::cout << name << ": " << faults[name] << "\n";
  }
}

struct Mutant {
  const char* name;
  PlantedFault in_scheduler = PlantedFault::kNone;
  ShellFault in_shell = ShellFault::kNone;
};

constexpr Mutant kMutants[] = {
    {"NoFence", PlantedFault::kNoFence},
    {"ReusedNumber", PlantedFault::kReusedNumber},
    {"ForgottenExpiry", PlantedFault::kForgottenExpiry},
    {"EndlessLease", PlantedFault::kEndlessLease},
    {"UnloggedResult", PlantedFault::kUnloggedResult},
    {"AckBeforeLog", PlantedFault::kAckBeforeLog},
    {"ForgottenDelay", PlantedFault::kForgottenDelay},
    {"AdoptsOldAttempts", PlantedFault::kAdoptsOldAttempts},
    {"ForgetsNumbersOnRestore", PlantedFault::kForgetsNumbersOnRestore},
    {"ForgetsNumbersInSnapshot", PlantedFault::kForgetsNumbersInSnapshot},
    {"ForgetsResultsInSnapshot", PlantedFault::kForgetsResultsInSnapshot},
    {"LeakedSlot", PlantedFault::kLeakedSlot},
    {"EndlessHedges", PlantedFault::kEndlessHedges},
    {"SilentWinner", PlantedFault::kSilentWinner},
    {"IgnoresCredit", PlantedFault::kIgnoresCredit},
    {"IgnoresMemory", PlantedFault::kIgnoresMemory},
    {"GivesUpAtOnce", PlantedFault::kGivesUpAtOnce},
    {"NeverGivesUp", PlantedFault::kNeverGivesUp},
    {"ForgottenRepair", PlantedFault::kForgottenRepair},
    {"ServesDraining", PlantedFault::kServesDraining},
    {"UnloggedRemoval", PlantedFault::kUnloggedRemoval},
    {"ForgetsOthersResults", PlantedFault::kForgetsOthersResults},
    {"IgnoresUserLimit", PlantedFault::kIgnoresUserLimit},
    {"SendsBeforeLog", PlantedFault::kNone, ShellFault::kSendsBeforeLog},
    {"LosesTail", PlantedFault::kNone, ShellFault::kLosesTail},
};

class PlantedFaultTest : public ::testing::TestWithParam<Mutant> {};

// In a process of its own: a broken scheduler may well abort.
TEST_P(PlantedFaultTest, IsCaught) {
  constexpr std::uint64_t kSeedsMax = 500;
  const pid_t child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    planted_fault = GetParam().in_scheduler;
    try {
      for (std::uint64_t seed = 0; seed < kSeedsMax; ++seed) {
        const std::vector<std::string> violations = Simulation(seed, GetParam().in_shell).Run();
        if (violations.empty()) continue;
        std::cout << violations.front() << std::endl;
        ::_exit(1);
      }
    } catch (const std::exception& error) {
      std::cout << "thrown: " << error.what() << std::endl;
      ::_exit(1);
    }
    ::_exit(0);
  }
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFSIGNALED(status) || WEXITSTATUS(status) != 0) << "no seed below " << kSeedsMax << " noticed";
}

INSTANTIATE_TEST_SUITE_P(Scheduler, PlantedFaultTest, ::testing::ValuesIn(kMutants), [](const auto& mutant) { return mutant.param.name; });

}  // namespace
}  // namespace trem::testing
