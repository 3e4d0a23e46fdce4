#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "mosaic/base/artefact_store.h"
#include "mosaic/base/status.h"
#include "proto/trem/v1/fleet.pb.h"

namespace trem {

// A result file at its final place.
struct PublishedFile {
  std::string name;  // As the EXPORT task calls it, for example "mosaic_quality.tif".
  std::filesystem::path path;
  std::string sha256;
  std::uint64_t bytes = 0;
};

// Where result `name` goes when the user asked for the mosaic at `output`: "mosaic.tif" to `output` itself, "mosaic_x.y" to
// "<stem of output>_x.y" beside it. Errors: kCorrupt for a name that is not a plain file name.
Result<std::filesystem::path> OutputPath(const std::filesystem::path& output, const std::string& name);

// Fails early when `output` could not be written at the end: not a .tif, a folder, its folder missing or not writable.
Status CheckOutput(const std::filesystem::path& output);

// Copies (and finishes, see published_text.h) the results from the artefact store to their places beside `output`. All of them are copied to
// a staging folder on the output's file system and their digests verified before the first appears under its final name; the mosaic
// itself appears last. On failure nothing is left. `work_folder`: preferred place of the staging folder.
Result<std::vector<PublishedFile>> PublishOutputs(const v1::JobStatus& job, const ArtefactStore& store,
                                                  const std::filesystem::path& output, const std::filesystem::path& work_folder);

}  // namespace trem
