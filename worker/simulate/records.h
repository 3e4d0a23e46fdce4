#pragma once

#include <filesystem>
#include <string>

#include "mosaic/base/status.h"
#include "worker/simulate/flight.h"
#include "worker/simulate/options.h"
#include "worker/simulate/truth.h"

namespace trem {

// "00042.png".
std::string FrameName(int index);

// Writes everything about a simulation that is not pixels into `directory`: frames/telemetry.csv, truth/frames.csv,
// truth/simulation.json and sortie.textproto. The folders exist.
Status WriteRecords(const SimulationOptions& options, const Truth& truth, const Flight& flight, const std::filesystem::path& directory);

// Reads a simulation back for scoring: the true cameras of truth/frames.csv (dropped exposures left out) and the figures of
// truth/simulation.json. Exposures carry camera, gain, offset and index; rows of telemetry stay empty.
struct SimulationRecord {
  SimulationOptions options;  // width_px, height_px, gsd_m, cells_per_pixel, bit_depth.
  Flight flight;              // Exposures, focal length and GPS bias.
  Truth truth;
};
Result<SimulationRecord> ReadSimulation(const std::filesystem::path& directory);

}  // namespace trem
