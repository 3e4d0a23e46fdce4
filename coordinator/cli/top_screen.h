#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include "proto/trem/v1/fleet.pb.h"

namespace trem {

// One look at a coordinator.
struct FleetView {
  std::string coordinator;
  std::vector<v1::JobStatus> jobs;
  std::vector<v1::WorkerStatus> workers;
  std::uint64_t tasks_done = 0;  // Of all jobs.
  double tasks_per_s = -1.0;     // Since the look before; negative: there was none.
};

// Tasks that are done, of all jobs.
std::uint64_t TasksDone(const std::vector<v1::JobStatus>& jobs);

// The lines of `trem top`, at most `rows` of at most `columns` characters (0: any number): running jobs first, the most urgent at the top,
// then others, the newest first; busy workers before idle ones. What does not fit is counted.
std::vector<std::string> TopScreen(const FleetView& view, int columns, int rows);

}  // namespace trem
