// trem-worker: the process that touches pixels. `serve` computes a coordinator's tasks; the other commands are what `trem` runs for its
// user commands of the same names.
#include <cstring>
#include <exception>
#include <iostream>
#include <string>
#include <vector>

#include "mosaic/base/exit_code.h"
#include "mosaic/base/suggest.h"
#include "mosaic/base/version.h"
#include "worker/app/compute_command.h"
#include "worker/app/enhance_command.h"
#include "worker/app/get_artefact_command.h"
#include "worker/app/inspect_command.h"
#include "worker/app/serve_command.h"
#include "worker/app/simulate_command.h"
#include "worker/app/store_commands.h"

namespace trem {
namespace {

struct Command {
  const char* name;
  const char* summary;
  int (*run)(int argc, char** argv);  // argv[0] is the command's name.
};

constexpr Command kCommands[] = {
    {"serve", "join a coordinator and compute its tasks", RunServeCommand},
    {"inspect", "say what a sortie holds", RunInspectCommand},
    {"enhance", "enhance one region of the sensor", RunEnhanceCommand},
    {"get-artefact", "copy an artefact from an object store", RunGetArtefactCommand},
    {"check-store", "see whether an object store can be used from here", RunCheckStoreCommand},
    {"sweep-store", "remove from an object store what no job has", RunSweepStoreCommand},
    {"simulate", "render a sortie with known truth", RunSimulateCommand},
};

void PrintHelp(std::ostream& out) {
  out << "usage: trem-worker COMMAND [OPTIONS]\n\nCommands:\n";
  for (const Command& command : kCommands) {
    out << "  " << command.name << std::string(14 - std::strlen(command.name), ' ') << command.summary << "\n";
  }
  out << "\n`trem-worker COMMAND --help` explains a command; --version prints the version.\n";
}

int Main(int argc, char** argv) {
  const std::string name = argc > 1 ? argv[1] : "";
  if (name == "compute") return RunComputeCommand(argc - 1, argv + 1);  // Not for people, so not in the list.
  if (name == "--help" || name == "-h" || name == "help") return PrintHelp(std::cout), 0;
  if (name == "--version") {
    std::cout << "trem-worker " << TREM_VERSION << " (engine revision " << kEngineRevision << ", protocol " << kProtocolVersion << ")\n";
    return 0;
  }
  std::vector<std::string> names;
  for (const Command& command : kCommands) {
    if (name == command.name) return command.run(argc - 1, argv + 1);
    names.emplace_back(command.name);
  }
  if (name.empty()) {
    PrintHelp(std::cerr);
  } else {
    std::cerr << "trem-worker: no such command: '" << name << "'" << DidYouMean(name, names) << " (see trem-worker --help)\n";
  }
  return kExitUsage;
}

}  // namespace
}  // namespace trem

int main(int argc, char** argv) {
  try {
    return trem::Main(argc, argv);
  } catch (const std::exception& error) {
    std::cerr << "trem-worker: " << error.what() << "\n";
    return 1;
  }
}
