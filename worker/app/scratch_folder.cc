#include "worker/app/scratch_folder.h"

#include <fcntl.h>
#include <stdlib.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <system_error>
#include <utility>

#include "mosaic/base/file.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

constexpr const char* kPrefix = "trem-worker-";
constexpr const char* kLockName = "/lock";

// The lock's descriptor; -1 when it is not there or somebody holds it.
int TryLock(const fs::path& folder, int flags) {
  const int fd = ::open((folder.string() + kLockName).c_str(), flags | O_RDWR | O_CLOEXEC | O_NOFOLLOW, 0600);
  if (fd >= 0 && ::flock(fd, LOCK_EX | LOCK_NB) == 0) return fd;
  if (fd >= 0) ::close(fd);
  return -1;
}

void RemoveAbandoned(const fs::path& parent) {
  std::error_code error;
  for (fs::directory_iterator it(parent, error), end; !error && it != end; it.increment(error)) {
    if (!it->path().filename().string().starts_with(kPrefix)) continue;
    struct stat info {};
    // In a folder where everybody may write, others' entries and links are none of ours.
    if (::lstat(it->path().c_str(), &info) != 0 || !S_ISDIR(info.st_mode) || info.st_uid != ::geteuid()) continue;
    const int fd = TryLock(it->path(), 0);
    if (fd < 0) continue;
    std::error_code ignored;
    fs::remove_all(it->path(), ignored);
    ::close(fd);
  }
}

}  // namespace

ScratchFolder::Held::~Held() {
  std::error_code ignored;
  fs::remove_all(path, ignored);
  if (lock_fd >= 0) ::close(lock_fd);
}

Result<ScratchFolder> ScratchFolder::Make(const fs::path& parent) {
  TREM_RETURN_IF_ERROR(MakeDirectories(parent));
  RemoveAbandoned(parent);
  std::string name = (parent / (std::string(kPrefix) + "XXXXXX")).string();
  if (::mkdtemp(name.data()) == nullptr) return FromErrno("cannot make a folder like " + name, errno);
  auto held = std::make_unique<Held>();
  held->path = name;
  held->lock_fd = TryLock(name, O_CREAT);
  if (held->lock_fd < 0) return FromErrno("cannot lock " + name, errno);
  return ScratchFolder(std::move(held));
}

}  // namespace trem
