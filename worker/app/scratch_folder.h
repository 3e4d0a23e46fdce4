#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "mosaic/base/status.h"

namespace trem {

// A folder for as long as this process lives. What a process that was killed has left is removed by the next one that makes such a folder
// at the same place: whoever lives holds a lock on his.
class ScratchFolder {
 public:
  // Makes "<parent>/trem-worker-XXXXXX", readable by this user only, and removes abandoned ones of this user beside it.
  static Result<ScratchFolder> Make(const std::filesystem::path& parent);

  const std::filesystem::path& path() const { return held_->path; }

 private:
  struct Held {
    std::filesystem::path path;
    int lock_fd = -1;
    ~Held();
  };
  explicit ScratchFolder(std::unique_ptr<Held> held) : held_(std::move(held)) {}

  std::unique_ptr<Held> held_;
};

}  // namespace trem
