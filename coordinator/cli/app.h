#pragma once

namespace trem {

// The program `trem`: parses the command line, runs the command, returns the exit code.
int RunTrem(int argc, char** argv);

}  // namespace trem
