#pragma once

#include <filesystem>
#include <string>

#include "mosaic/base/artefact_store.h"
#include "mosaic/base/status.h"
#include "proto/trem/v1/job.pb.h"

namespace trem {

// Brings a sortie's files to this machine where their paths are not such that this worker can open them: virtual paths of GDAL's
// (/vsis3/bucket/leg) and uploads (upload-<digest>-<bytes>/leg.ts, see proto/codec/upload.h). They are put below a folder that becomes this
// process' working folder, and the sortie gets paths relative to it: the same on every worker, so that results do not depend on where a
// cache lies.
class InputFiles {
 public:
  // Makes `folder` and enters it.
  static Result<InputFiles> Open(const std::filesystem::path& folder);

  // The sortie with every path as this worker opens it; its files are there. Those of another sortie are removed first.
  Result<v1::Sortie> Bring(const v1::Sortie& sortie, const ArtefactStore& store);

 private:
  explicit InputFiles(std::filesystem::path folder) : folder_(std::move(folder)) {}
  Status BringBeside(const v1::Source& recording, const v1::Telemetry& telemetry) const;
  Status BringPath(const ArtefactStore& store, std::string* path);
  Status BringUpload(const ArtefactStore& store, const std::string& upload);

  std::filesystem::path folder_;
  std::string source_;  // Of the sortie whose files are there.
};

}  // namespace trem
