#pragma once

namespace trem {

// `trem-worker compute`: what `serve` starts to compute in. Not for people. Returns the exit code.
int RunComputeCommand(int argc, char** argv);

}  // namespace trem
