#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string_view>

#include "mosaic/base/status.h"

namespace trem {

// A file that is read or written piece by piece, at places that the caller names. Owns its descriptor. Errors name the path.
class OpenFile {
 public:
  // `flags` as for open(2); what is created is readable by everybody.
  static Result<OpenFile> Open(const std::filesystem::path& path, int flags);
  ~OpenFile();
  OpenFile(OpenFile&& other) noexcept;
  OpenFile& operator=(OpenFile&&) = delete;

  Result<std::uint64_t> Size() const;
  // Fills `data` with the bytes from `offset` on; kCorrupt when the file ends before.
  Status ReadAt(std::uint64_t offset, std::span<char> data) const;
  // Also starts the bytes on their way to the disk, without waiting: an fsync at the end of a long file has little left to do.
  Status WriteAt(std::uint64_t offset, std::string_view data) const;

 private:
  OpenFile(std::filesystem::path path, int fd) : path_(std::move(path)), fd_(fd) {}

  std::filesystem::path path_;
  int fd_;  // -1: moved from.
};

}  // namespace trem
