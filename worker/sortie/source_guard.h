#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "mosaic/base/status.h"
#include "proto/trem/v1/job.pb.h"

namespace trem {

// Which files a job may make this worker read: those below given folders, after every symbolic link has been followed. Without it, whoever
// may submit could have any file that the worker's user can read mapped, or its first bytes quoted in an error.
class SourceGuard {
 public:
  // `roots`: folders (they have to exist), or prefixes of GDAL's virtual paths ("/vsis3/bucket/"). None: everything is allowed, or
  // nothing when `closed`. Uploads are always allowed: their files come from the client.
  static Result<SourceGuard> Make(const std::vector<std::string>& roots, bool closed);

  // Checks every path of the spec, what lies in the source's folder or matches its glob, and telemetry found beside it. kInvalidInput names
  // the field and the path; what does not exist is left to whoever opens it. The files may be changed between this and their opening:
  // keep the roots writable only by people who may read everything that the worker can.
  Status Check(const v1::Sortie& sortie) const;

 private:
  bool Allows(const std::filesystem::path& path) const;
  Status CheckPath(const std::string& field, const std::filesystem::path& path) const;
  Status CheckNamed(const v1::Sortie& sortie) const;  // Every path but the source's.
  Status CheckEntries(const std::filesystem::path& source) const;

  bool open_ = false;
  std::vector<std::filesystem::path> roots_;  // Canonical.
  std::vector<std::string> virtual_roots_;    // With a slash at the end.
};

}  // namespace trem
