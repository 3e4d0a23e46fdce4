#pragma once

#include <filesystem>
#include <functional>

#include "mosaic/base/status.h"
#include "worker/simulate/options.h"

namespace trem {

struct SimulationSummary {
  int frame_count = 0;  // Written.
  int dropped_count = 0;
  double speed_px = 0.0;
  double height_m = 0.0;  // Of the camera above the ground.
  double gps_bias_east_m = 0.0;
  double gps_bias_north_m = 0.0;
};

// Checks every option against its range; the message names the command line option.
Status CheckSimulationOptions(const SimulationOptions& options);

// Simulates a sortie and leaves in `directory`:
//
//   frames/NNNNN.png        exposures that were not dropped, 8 or 16 bit grey
//   frames/telemetry.csv    as docs describe, with the simulated instrument errors
//   truth/truth.tif         the ground, georeferenced
//   truth/frames.csv        true pose, gain and offset of every frame, and the position bias
//   truth/simulation.json   all options and derived figures
//   sortie.textproto        a job over frames/
//
// All of it appears at once when everything is written: it is made in a folder beside `directory` and renamed. A folder that is not
// empty is an error; with options.overwrite a former simulation (and nothing else) is replaced. `progress(done, total)` is called from the
// calling thread. The bytes depend on options and truth, not on the thread count.
Result<SimulationSummary> Simulate(const SimulationOptions& options, const std::filesystem::path& directory,
                                   const std::function<void(int done, int total)>& progress);

}  // namespace trem
