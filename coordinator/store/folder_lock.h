#pragma once

#include <filesystem>
#include <memory>

#include "mosaic/base/status.h"

namespace trem {

// Exclusive hold of a folder by one process, by flock on <folder>/coordinator.lock; ends with the object or the process. The file holds the
// process id of the holder as text, for people and messages only.
class FolderLock {
 public:
  // kUnavailable, naming the holder's process id when known, when another process (or another FolderLock of this one) has it.
  static Result<std::unique_ptr<FolderLock>> Acquire(const std::filesystem::path& folder);
  ~FolderLock();
  FolderLock(const FolderLock&) = delete;
  FolderLock& operator=(const FolderLock&) = delete;

 private:
  explicit FolderLock(int fd) : fd_(fd) {}
  int fd_;
};

}  // namespace trem
