#pragma once

namespace trem {

// `trem inspect SORTIE [options]`: reads the sortie as a job's first task would and says what it found. The report goes to stdout,
// progress and errors to stderr. Returns the exit code: 0 done, 1 failed, 2 usage, 3 invalid input.
int RunInspectCommand(int argc, char** argv);

}  // namespace trem
