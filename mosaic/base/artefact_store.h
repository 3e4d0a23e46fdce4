#pragma once

#include <cstdint>
#include <filesystem>
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

  // A fresh, empty path in <root>/tmp whose extension is `extension` (".tif"; GDAL picks drivers by it).
  std::filesystem::path NewTemporaryPath(const std::string& extension) const;
  // Moves the file at `temporary` (made by NewTemporaryPath) into the store.
  Result<ArtefactRef> PutFile(const std::string& name, const std::filesystem::path& temporary) const;
  Result<ArtefactRef> PutBytes(const std::string& name, std::string_view bytes) const;

  // Where the object is; fails with kNotFound when missing, kCorrupt when its size differs from the ref.
  Result<std::filesystem::path> Locate(const ArtefactRef& ref) const;
  // Reads an object and verifies its digest; kCorrupt when it differs.
  Result<std::string> ReadVerified(const ArtefactRef& ref, std::uint64_t max_bytes) const;
  // Digest check of an object without keeping it in memory.
  Status Verify(const ArtefactRef& ref) const;

  const std::filesystem::path& root() const { return root_; }

 private:
  explicit ArtefactStore(std::filesystem::path root) : root_(std::move(root)) {}
  std::filesystem::path ObjectPath(const std::string& sha256) const;

  std::filesystem::path root_;
};

}  // namespace trem
