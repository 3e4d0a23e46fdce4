#pragma once

#include <string>
#include <vector>

#include "proto/trem/v1/job.pb.h"

namespace trem {

// A field of a spec that names a file.
struct SortiePath {
  const char* field;  // As a user writes it: "telemetry.dem_path".
  std::string* path;  // Within the sortie that was asked; not empty.
};

// Every path that is set in `sortie`, the source's first: whoever checks, moves or copies a sortie's files must not forget one.
std::vector<SortiePath> PathsOf(v1::Sortie* sortie);

}  // namespace trem
