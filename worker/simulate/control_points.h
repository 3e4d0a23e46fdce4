#pragma once

#include <string>

#include "mosaic/base/status.h"
#include "worker/simulate/flight.h"
#include "worker/simulate/options.h"
#include "worker/simulate/truth.h"

namespace trem {

// gcp.csv of a simulation: options.control_count points spread along the path and across the image, each in up to three frames.
Result<std::string> ControlPointsCsv(const SimulationOptions& options, const Truth& truth, const Flight& flight);

}  // namespace trem
