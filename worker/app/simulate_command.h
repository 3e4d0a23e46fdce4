#pragma once

namespace trem {

// `trem simulate [TRUTH] -o DIR [options]`: renders a sortie with known truth. Progress and messages go to stderr, the summary to stdout.
// Returns the exit code: 0 done, 1 failed, 2 usage, 3 invalid input.
int RunSimulateCommand(int argc, char** argv);

}  // namespace trem
