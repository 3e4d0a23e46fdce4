#include "mosaic/base/artefact_store.h"

#include <unistd.h>

#include <atomic>

#include "mosaic/base/digest.h"
#include "mosaic/base/file.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

// Whether the file is there with these bytes.
bool Holds(const fs::path& path, std::uint64_t bytes, const std::string& sha256) {
  std::error_code error;
  if (fs::file_size(path, error) != bytes || error) return false;
  const auto found = Sha256HexOfFile(path);
  return found.ok() && *found == sha256;
}

}  // namespace

Result<ArtefactStore> ArtefactStore::Open(const fs::path& root) {
  TREM_RETURN_IF_ERROR(MakeDirectories(root / "objects"));
  TREM_RETURN_IF_ERROR(MakeDirectories(root / "tmp"));
  return ArtefactStore(root);
}

fs::path ArtefactStore::NewTemporaryPath(const std::string& extension) const {
  static std::atomic<std::uint64_t> counter{0};
  return root_ / "tmp" / (std::to_string(::getpid()) + "-" + std::to_string(counter.fetch_add(1)) + extension);
}

fs::path ArtefactStore::ObjectPath(const std::string& sha256) const { return root_ / "objects" / sha256.substr(0, 2) / sha256; }

Result<ArtefactRef> ArtefactStore::PutFile(const std::string& name, const fs::path& temporary) const {
  TREM_ASSIGN_OR_RETURN(const std::string sha256, Sha256HexOfFile(temporary));
  std::error_code error;
  const std::uint64_t bytes = fs::file_size(temporary, error);
  if (error) return FromErrno("cannot stat " + temporary.string(), error.value());
  const fs::path object = ObjectPath(sha256);
  TREM_RETURN_IF_ERROR(MakeDirectories(object.parent_path()));
  // Other bytes under this name are damage, not this artefact: the rename puts the good ones in their place.
  if (Holds(object, bytes, sha256)) {
    fs::remove(temporary, error);
  } else {
    TREM_RETURN_IF_ERROR(PublishFile(temporary, object));
  }
  return ArtefactRef{name, sha256, bytes};
}

Result<ArtefactRef> ArtefactStore::PutBytes(const std::string& name, std::string_view bytes) const {
  const fs::path temporary = NewTemporaryPath(".bin");
  TREM_RETURN_IF_ERROR(WriteFileAtomically(temporary, bytes));
  return PutFile(name, temporary);
}

Result<fs::path> ArtefactStore::Locate(const ArtefactRef& ref) const {
  if (!IsSha256Hex(ref.sha256)) return Corrupt("artefact " + ref.name + " has the malformed digest '" + ref.sha256.substr(0, 80) + "'");
  const fs::path object = ObjectPath(ref.sha256);
  std::error_code error;
  const std::uint64_t bytes = fs::file_size(object, error);
  if (error) return NotFound("artefact " + ref.name + " (" + object.string() + "): " + error.message());
  if (bytes != ref.bytes) {
    return Corrupt("artefact " + ref.name + " (" + object.string() + ") has " + std::to_string(bytes) + " bytes; expected " +
                   std::to_string(ref.bytes));
  }
  return object;
}

Result<std::string> ArtefactStore::ReadVerified(const ArtefactRef& ref, std::uint64_t max_bytes) const {
  TREM_ASSIGN_OR_RETURN(const fs::path object, Locate(ref));
  TREM_ASSIGN_OR_RETURN(std::string bytes, ReadFile(object, max_bytes));
  if (const std::string found = Sha256Hex(bytes); found != ref.sha256) {
    return Corrupt("artefact " + ref.name + " (" + object.string() + ") has digest " + found + "; expected " + ref.sha256);
  }
  return bytes;
}

Status ArtefactStore::Verify(const ArtefactRef& ref) const {
  TREM_ASSIGN_OR_RETURN(const fs::path object, Locate(ref));
  TREM_ASSIGN_OR_RETURN(const std::string found, Sha256HexOfFile(object));
  if (found != ref.sha256) {
    return Corrupt("artefact " + ref.name + " (" + object.string() + ") has digest " + found + "; expected " + ref.sha256);
  }
  return {};
}

}  // namespace trem
