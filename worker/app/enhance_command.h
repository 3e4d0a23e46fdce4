#pragma once

namespace trem {

// `trem enhance SORTIE -o scene.tif [options]`: resolution enhancement of one ROI fixed in the sensor, without telemetry or mosaic.
// Messages and progress go to stderr, the summary to stdout. Returns the exit code: 0 done, 1 failed, 2 usage, 3 invalid input,
// 130 interrupted.
int RunEnhanceCommand(int argc, char** argv);

}  // namespace trem
