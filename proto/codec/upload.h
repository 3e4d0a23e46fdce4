#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "mosaic/base/artefact_store.h"
#include "proto/trem/v1/upload.pb.h"

namespace trem {

// The first part of paths into an upload: "upload-<digest>-<bytes>".
std::string UploadName(const ArtefactRef& list);
// The list's reference when `path` leads into an upload and stays there; nullopt for every other path.
std::optional<ArtefactRef> UploadOfPath(std::string_view path);

// Ok when every name is relative, stays below the upload, and occurs once, and every digest is one. kCorrupt names the file.
Status CheckUploadList(const v1::UploadList& list);

}  // namespace trem
