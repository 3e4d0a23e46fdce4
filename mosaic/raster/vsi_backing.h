#pragma once

#include <string>

#include "mosaic/base/artefact_store.h"

namespace trem {

// An artefact store at any of GDAL's virtual paths, such as /vsis3/bucket/prefix: objects are named by digest below <root>/objects. Where
// the credentials come from is GDAL's business (environment, profile, instance role); they appear in no message.
class VsiBacking final : public ArtefactBacking {
 public:
  explicit VsiBacking(std::string root) : root_(std::move(root)) {}

  // Errors: kNotFound for an object that is not there; kUnavailable with GDAL's reason when the store cannot be reached or refuses.
  Result<std::string> Fetch(const ArtefactRef& ref, const std::filesystem::path& path) override;
  Status Deliver(const ArtefactRef& ref, const std::filesystem::path& path) override;
  // Ok when the store lets this process look into it. kInvalidInput when it refuses, kUnavailable when it does not answer.
  Status Check() const;

 private:
  std::string ObjectPath(const std::string& sha256) const { return root_ + "/objects/" + sha256.substr(0, 2) + "/" + sha256; }

  std::string root_;
};

// Copies the file, or every file of the folder (not its subfolders), at GDAL's virtual path `source` to `target`, which gets the same kind
// and names. What is there already in the same size is left alone. Errors: kNotFound; kInvalidInput when the store refuses, which no other
// try will change; kUnavailable; kExhausted when the disk is full.
Status CopyVsiTree(const std::string& source, const std::filesystem::path& target);

// Whether `path` is one of GDAL's virtual paths.
inline bool IsVsiPath(const std::string& path) { return path.starts_with("/vsi"); }

}  // namespace trem
