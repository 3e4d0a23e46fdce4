#include "worker/app/get_artefact_command.h"

#include <CLI/CLI.hpp>
#include <iostream>
#include <string>

#include "mosaic/base/digest.h"
#include "mosaic/base/exit_code.h"
#include "mosaic/raster/vsi_backing.h"
#include "worker/app/usage.h"

namespace trem {

int RunGetArtefactCommand(int argc, char** argv) {
  std::string store, output;
  ArtefactRef ref;
  CLI::App app("Copies one artefact from an object store to a file.", "trem-worker get-artefact");
  app.add_option("--store", store, "/vsis3/BUCKET/PREFIX or another of GDAL's virtual paths")->required();
  app.add_option("--sha256", ref.sha256, "Digest of the artefact")->required();
  app.add_option("-o,--output", output, "File to write")->required();
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return ExitOfParseError(&app, error);
  }
  ref.name = ref.sha256;
  const Status status = IsSha256Hex(ref.sha256) ? VsiBacking(store).Fetch(ref, output).status() : InvalidInput("--sha256 is not a digest");
  if (!status.ok()) std::cerr << "trem-worker: " << status.message() << "\n";
  return ExitCodeOf(status);
}

}  // namespace trem
