#include "mosaic/base/artefact_store.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <memory>
#include <mutex>
#include <vector>

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

Status WrongDigest(const ArtefactRef& ref, const fs::path& object, const std::string& found) {
  return Corrupt("artefact " + ref.name + " (" + object.string() + ") has digest " + found + "; expected " + ref.sha256);
}

}  // namespace

Result<ArtefactStore> ArtefactStore::Open(const fs::path& root) {
  TREM_RETURN_IF_ERROR(MakeDirectories(root / "objects"));
  TREM_RETURN_IF_ERROR(MakeDirectories(root / "tmp"));
  return ArtefactStore(root);
}

Result<ArtefactStore> ArtefactStore::OpenCache(const fs::path& root, std::shared_ptr<ArtefactBacking> backing) {
  TREM_ASSIGN_OR_RETURN(ArtefactStore store, Open(root));
  store.backing_ = std::move(backing);
  return store;
}

Status ArtefactStore::FetchMissing(const ArtefactRef& ref) const {
  // One after the other, within this process and among those that share the cache: the second finds what the first has fetched.
  static std::mutex mutex;
  const std::lock_guard guard(mutex);
  const fs::path partial = root_ / "tmp" / (ref.sha256 + ".part");
  const fs::path object = ObjectPath(ref.sha256);
  const int fd = ::open(partial.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0644);
  if (fd < 0) return FromErrno("cannot create " + partial.string(), errno);
  const std::unique_ptr<const int, void (*)(const int*)> closer(&fd, [](const int* open_fd) { ::close(*open_fd); });
  while (::flock(fd, LOCK_EX) != 0 && errno == EINTR) {
  }
  std::error_code error;
  if (fs::file_size(object, error) == ref.bytes && !error) {
    fs::remove(partial, error);
    return {};
  }
  for (;;) {
    const bool is_resumed = fs::file_size(partial, error) > 0 && !error;
    TREM_ASSIGN_OR_RETURN(std::string found, backing_->Fetch(ref, partial));
    if (found.empty()) {
      TREM_ASSIGN_OR_RETURN(found, Sha256HexOfFile(partial));
    }
    if (found == ref.sha256) break;
    // Emptied, not removed: whoever waits for the lock holds this very file. What an earlier try left may have been the damaged part.
    fs::resize_file(partial, 0, error);
    if (!is_resumed || error) return Corrupt("artefact " + ref.name + " arrived with digest " + found + "; expected " + ref.sha256);
  }
  TREM_RETURN_IF_ERROR(MakeDirectories(object.parent_path()));
  return PublishFile(partial, object);
}

bool ArtefactStore::Forget(const ArtefactRef& ref) const {
  std::error_code ignored;
  return backing_ && fs::remove(ObjectPath(ref.sha256), ignored);
}

Status ArtefactStore::Trim(std::uint64_t bytes_max, std::chrono::seconds spared) const {
  struct Object {
    fs::file_time_type used_at;
    std::uint64_t bytes;
    fs::path path;
  };
  std::vector<Object> objects;
  std::uint64_t total = 0;
  std::error_code error;
  for (fs::recursive_directory_iterator it(root_ / "objects", error), end; !error && it != end; it.increment(error)) {
    std::error_code gone;  // Another process may remove it meanwhile.
    if (!it->is_regular_file(gone)) continue;
    objects.push_back({it->last_write_time(gone), it->file_size(gone), it->path()});
    total += gone ? 0 : objects.back().bytes;
    if (gone) objects.pop_back();
  }
  if (error) return FromErrno("cannot list " + (root_ / "objects").string(), error.value());
  std::sort(objects.begin(), objects.end(), [](const Object& a, const Object& b) { return a.used_at < b.used_at; });
  const auto spared_from = fs::file_time_type::clock::now() - spared;
  for (const Object& object : objects) {
    if (total <= bytes_max || object.used_at > spared_from) break;
    if (fs::remove(object.path, error)) total -= object.bytes;
  }
  return {};
}

fs::path ArtefactStore::NewTemporaryPath(const std::string& extension) const {
  static std::atomic<std::uint64_t> counter{0};
  return root_ / "tmp" / (std::to_string(::getpid()) + "-" + std::to_string(counter.fetch_add(1)) + extension);
}

fs::path ArtefactStore::ObjectPath(const std::string& sha256) const { return root_ / "objects" / sha256.substr(0, 2) / sha256; }

Result<ArtefactRef> ArtefactStore::PutFile(const std::string& name, const fs::path& temporary) const {
  TREM_ASSIGN_OR_RETURN(const std::string sha256, Sha256HexOfFile(temporary));
  return PutHashed(name, sha256, temporary);
}

Result<ArtefactRef> ArtefactStore::PutHashed(const std::string& name, const std::string& sha256, const fs::path& temporary) const {
  std::error_code error;
  const std::uint64_t bytes = fs::file_size(temporary, error);
  if (error) return FromErrno("cannot stat " + temporary.string(), error.value());
  const fs::path object = ObjectPath(sha256);
  TREM_RETURN_IF_ERROR(MakeDirectories(object.parent_path()));
  // Other bytes under this name are damage, not this artefact: the rename puts the good ones in their place.
  if (Holds(object, bytes, sha256)) {
    fs::remove(temporary, error);
    Touch(sha256);  // A sweep spares it until it is in use.
  } else {
    TREM_RETURN_IF_ERROR(PublishFile(temporary, object));
  }
  const ArtefactRef ref{name, sha256, bytes};
  if (backing_) TREM_RETURN_IF_ERROR(backing_->Deliver(ref, object));
  return ref;
}

void ArtefactStore::Touch(const std::string& sha256) const {
  std::error_code ignored;
  fs::last_write_time(ObjectPath(sha256), fs::file_time_type::clock::now(), ignored);
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
  if (fs::is_symlink(object, error)) return Corrupt("artefact " + ref.name + " (" + object.string() + ") is a link; expected a file");
  if (backing_) {
    if (fs::file_size(object, error) != ref.bytes || error) TREM_RETURN_IF_ERROR(FetchMissing(ref));
    Touch(ref.sha256);  // Used just now: Trim spares it.
  }
  const std::uint64_t bytes = fs::file_size(object, error);
  if (error) return NotFound("artefact " + ref.name + " (" + object.string() + "): " + error.message());
  if (bytes != ref.bytes) {
    return Corrupt("artefact " + ref.name + " (" + object.string() + ") has " + std::to_string(bytes) + " bytes; expected " +
                   std::to_string(ref.bytes));
  }
  return object;
}

Result<fs::path> ArtefactStore::Find(const std::string& sha256, std::uint64_t* bytes) const {
  if (!IsSha256Hex(sha256)) return Corrupt("'" + sha256.substr(0, 80) + "' is not the digest of an artefact");
  const fs::path object = ObjectPath(sha256);
  std::error_code error;
  *bytes = fs::file_size(object, error);
  if (error) return NotFound("artefact " + object.string() + ": " + error.message());
  return object;
}

Result<std::string> ArtefactStore::ReadVerified(const ArtefactRef& ref, std::uint64_t max_bytes) const {
  for (bool is_mended = false;; is_mended = true) {
    TREM_ASSIGN_OR_RETURN(const fs::path object, Locate(ref));
    TREM_ASSIGN_OR_RETURN(std::string bytes, ReadFile(object, max_bytes));
    const std::string found = Sha256Hex(bytes);
    if (found == ref.sha256) return bytes;
    if (is_mended || !Forget(ref)) return WrongDigest(ref, object, found);
  }
}

Status ArtefactStore::Verify(const ArtefactRef& ref) const {
  for (bool is_mended = false;; is_mended = true) {
    TREM_ASSIGN_OR_RETURN(const fs::path object, Locate(ref));
    TREM_ASSIGN_OR_RETURN(const std::string found, Sha256HexOfFile(object));
    if (found == ref.sha256) return {};
    if (is_mended || !Forget(ref)) return WrongDigest(ref, object, found);
  }
}

}  // namespace trem
