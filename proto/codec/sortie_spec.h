#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "mosaic/base/status.h"
#include "proto/trem/v1/job.pb.h"

namespace trem {

// Parses a spec file's text. `file_name` decides the format (.json: JSON, else text proto) and stands in front of every error:
// "<file>:<line>:<column>: unknown field 'ratoi' in trem.v1.Tre; did you mean 'ratio'?". At most 1 MiB and 32 levels deep.
Result<v1::Sortie> ParseSortieSpec(std::string_view text, const std::string& file_name);

// Applies one "--set tre.ratio=3". Errors name the path, the value found and what was expected.
Status ApplyOverride(const std::string& assignment, v1::Sortie* sortie);

// Checks every value against its range and fills every default in, so that two specs that mean the same become the same message.
// Errors name the field, the value and the range.
Status CompleteSortie(v1::Sortie* sortie);

// What the command line calls SORTIE: a spec file (.textproto, .json), a video file, a folder of images, or a glob. Returns the
// complete spec with absolute, normalised paths. An override "more=SORTIE" adds that sortie's source and telemetry as one more recording.
// kNotFound when the path (or glob) matches nothing.
Result<v1::Sortie> LoadSortie(const std::string& argument, const std::vector<std::string>& overrides);

}  // namespace trem
