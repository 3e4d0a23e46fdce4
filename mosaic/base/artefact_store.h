#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>

#include "mosaic/base/status.h"

namespace trem {

// A stored result: the name a task gave it, its content hash and its size.
struct ArtefactRef {
  std::string name;    // What it is to the task, for example "scene-003.tif". Not part of the address.
  std::string sha256;  // 64 lower-case hexadecimal digits: the address.
  std::uint64_t bytes = 0;
};

// Where a store that is only a cache gets objects from and delivers them to. Calls come from one thread at a time.
class ArtefactBacking {
 public:
  virtual ~ArtefactBacking() = default;
  // Writes the object to `path`; what is there already is the beginning of it, from a try that broke off. Returns the SHA-256 of all that
  // is there then, or nothing if it was not taken on the way: the store compares it, or reads the file.
  virtual Result<std::string> Fetch(const ArtefactRef& ref, const std::filesystem::path& path) = 0;
  // Returns when the object, the file at `path`, is where others find it.
  virtual Status Deliver(const ArtefactRef& ref, const std::filesystem::path& path) = 0;
};

// A content-addressed folder that coordinator, workers and clients share:
//
//   <root>/objects/ab/abcdef...   immutable, named by SHA-256
//   <root>/tmp/                   files being written; whatever is here after a crash is rubbish
//
// Put is idempotent: the same bytes give the same ref, whoever writes them and however often. Objects are published by
// write-temp, fsync, rename, so that a reader never sees half of one. Safe for several processes and threads.
class ArtefactStore {
 public:
  // Creates the folders when missing.
  static Result<ArtefactStore> Open(const std::filesystem::path& root);

  // A cache in front of `backing`: what is missing here is fetched, what is put here is delivered before Put returns. Several processes
  // may share the folder.
  static Result<ArtefactStore> OpenCache(const std::filesystem::path& root, std::shared_ptr<ArtefactBacking> backing);
  // Removes the objects that were used least recently, until the rest has at most `bytes_max`; what was used within `spared` stays all the
  // same, because someone else who shares the cache may be reading it. For caches.
  Status Trim(std::uint64_t bytes_max, std::chrono::seconds spared) const;

  // A fresh, empty path in <root>/tmp whose extension is `extension` (".tif"; GDAL picks drivers by it).
  std::filesystem::path NewTemporaryPath(const std::string& extension) const;
  // Moves the file at `temporary` (made by NewTemporaryPath) into the store.
  Result<ArtefactRef> PutFile(const std::string& name, const std::filesystem::path& temporary) const;
  Result<ArtefactRef> PutBytes(const std::string& name, std::string_view bytes) const;
  // PutFile for a caller who has just computed the file's digest himself; a long file is not read once more.
  Result<ArtefactRef> PutHashed(const std::string& name, const std::string& sha256, const std::filesystem::path& temporary) const;

  // Where the object is; fails with kNotFound when missing, kCorrupt when its size differs from the ref.
  Result<std::filesystem::path> Locate(const ArtefactRef& ref) const;
  // Where the object of this digest is, whatever its size, which goes to `bytes`. Does not ask a backing.
  Result<std::filesystem::path> Find(const std::string& sha256, std::uint64_t* bytes) const;
  // Makes the object as young as if it had just been put, where it is there.
  void Touch(const std::string& sha256) const;
  // Reads an object and verifies its digest; kCorrupt when it differs. Of a cache, an object that was damaged here is fetched again.
  Result<std::string> ReadVerified(const ArtefactRef& ref, std::uint64_t max_bytes) const;
  // Digest check of an object without keeping it in memory; a cache mends itself, as above.
  Status Verify(const ArtefactRef& ref) const;

  const std::filesystem::path& root() const { return root_; }

 private:
  explicit ArtefactStore(std::filesystem::path root) : root_(std::move(root)) {}
  std::filesystem::path ObjectPath(const std::string& sha256) const;
  Status FetchMissing(const ArtefactRef& ref) const;
  // Drops the object from a cache, so that it is fetched again; false when this is no cache.
  bool Forget(const ArtefactRef& ref) const;

  std::filesystem::path root_;
  std::shared_ptr<ArtefactBacking> backing_;  // Shared: stores are copied. Null: the folder is the store itself.
};

}  // namespace trem
