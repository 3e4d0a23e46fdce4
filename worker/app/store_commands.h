#pragma once

namespace trem {

// What `trem` runs where GDAL and the credentials of an object store are. Each returns the exit code.

// `trem-worker check-store`: puts a small object into the store and gets it back.
int RunCheckStoreCommand(int argc, char** argv);
// `trem-worker sweep-store`: removes what no job has. Prints one line: objects and bytes removed, bytes left.
int RunSweepStoreCommand(int argc, char** argv);

}  // namespace trem
