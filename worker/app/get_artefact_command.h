#pragma once

namespace trem {

// `trem-worker get-artefact`: one artefact from an object store to a file; what `trem fetch` runs, which links no GDAL. Returns the exit
// code.
int RunGetArtefactCommand(int argc, char** argv);

}  // namespace trem
