#pragma once

namespace trem {

// `trem-worker serve`: joins a coordinator and computes its tasks until SIGTERM or SIGINT. Returns the exit code; see --help.
int RunServeCommand(int argc, char** argv);

}  // namespace trem
