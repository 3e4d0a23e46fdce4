#include "coordinator/store/folder_lock.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <string>

namespace trem {
namespace {

std::string HolderText(int fd) {
  std::array<char, 32> buffer{};
  const ssize_t count = pread(fd, buffer.data(), buffer.size() - 1, 0);
  std::string digits;
  for (ssize_t i = 0; i < count && buffer[static_cast<std::size_t>(i)] >= '0' && buffer[static_cast<std::size_t>(i)] <= '9'; ++i) {
    digits += buffer[static_cast<std::size_t>(i)];
  }
  return digits.empty() ? "another process" : "process " + digits;
}

}  // namespace

Result<std::unique_ptr<FolderLock>> FolderLock::Acquire(const std::filesystem::path& folder) {
  const std::filesystem::path path = folder / "coordinator.lock";
  const int fd = open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (fd < 0) return FromErrno("cannot open " + path.string(), errno);
  std::unique_ptr<FolderLock> lock(new FolderLock(fd));
  if (flock(fd, LOCK_EX | LOCK_NB) != 0) {
    if (errno != EWOULDBLOCK) return FromErrno("cannot lock " + path.string(), errno);
    return Unavailable("the state folder " + folder.string() + " is in use by " + HolderText(fd) +
                       "; stop that coordinator or choose another --state folder");
  }
  const std::string text = std::to_string(getpid()) + "\n";
  if (ftruncate(fd, 0) != 0 || pwrite(fd, text.data(), text.size(), 0) != static_cast<ssize_t>(text.size())) {
    return FromErrno("cannot write " + path.string(), errno);
  }
  return lock;
}

FolderLock::~FolderLock() { close(fd_); }

}  // namespace trem
