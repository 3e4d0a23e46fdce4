#pragma once

// Places where a test can break a rule of the scheduler, to see that the simulation notices. In the programs TREM_PLANTED is false and
// costs nothing; only tests/unit/coordinator/scheduling compiles this folder with TREM_PLANTED_FAULTS.
#ifdef TREM_PLANTED_FAULTS

namespace trem {

enum class PlantedFault {
  kNone,
  kNoFence,                  // Results of any attempt are taken.
  kReusedNumber,             // A task is handed out again under the same number.
  kForgottenExpiry,          // A lease that ends is not handed out again.
  kEndlessLease,             // Leases do not end.
  kUnloggedResult,           // A result is not written down.
  kAckBeforeLog,             // A result is acknowledged before it is written down.
  kForgottenDelay,           // A task that waits to be tried again is forgotten.
  kAdoptsOldAttempts,        // A worker that comes back goes on with whatever it names.
  kForgetsNumbersOnRestore,  // Attempt numbers begin anew after a restart.
  kForgetsNumbersInSnapshot,
  kForgetsResultsInSnapshot,
  kLeakedSlot,     // A worker's slot is not freed by its result.
  kEndlessHedges,  // A straggler gets one more attempt at every tick.
  kSilentWinner,   // The slower attempt is not told that the task is finished.
  kIgnoresCredit,
  kIgnoresMemory,
  kGivesUpAtOnce,  // One failure makes a hole.
  kNeverGivesUp,
  kForgottenRepair,       // A damaged artefact is not made again.
  kServesDraining,        // A draining worker gets new tasks.
  kUnloggedRemoval,       // That a job was removed is not written down.
  kForgetsOthersResults,  // With a removed job its results go, whoever else has them.
  kIgnoresUserLimit,
};

inline PlantedFault planted_fault = PlantedFault::kNone;

}  // namespace trem

#define TREM_PLANTED(fault) (::trem::planted_fault == ::trem::PlantedFault::fault)
#else
#define TREM_PLANTED(fault) false
#endif
