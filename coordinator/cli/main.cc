#include <cstdio>
#include <exception>

#include "coordinator/cli/app.h"
#include "coordinator/cli/terminal.h"

int main(int argc, char** argv) {
  try {
    return trem::RunTrem(argc, argv);
  } catch (const std::exception& exception) {
    trem::PrintError(std::string("unexpected failure: ") + exception.what());
    return trem::kExitFailed;
  }
}
