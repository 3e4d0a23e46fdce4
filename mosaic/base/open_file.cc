#include "mosaic/base/open_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <utility>

namespace trem {

Result<OpenFile> OpenFile::Open(const std::filesystem::path& path, int flags) {
  const int fd = ::open(path.c_str(), flags | O_CLOEXEC, 0644);
  if (fd < 0) return FromErrno("cannot open " + path.string(), errno);
  return OpenFile(path, fd);
}

OpenFile::~OpenFile() {
  if (fd_ >= 0) ::close(fd_);
}

OpenFile::OpenFile(OpenFile&& other) noexcept : path_(std::move(other.path_)), fd_(std::exchange(other.fd_, -1)) {}

Result<std::uint64_t> OpenFile::Size() const {
  struct stat info {};
  if (::fstat(fd_, &info) != 0) return FromErrno("cannot stat " + path_.string(), errno);
  if (!S_ISREG(info.st_mode)) return InvalidInput(path_.string() + " is no file; expected one");
  return static_cast<std::uint64_t>(info.st_size);
}

Status OpenFile::ReadAt(std::uint64_t offset, std::span<char> data) const {
  while (!data.empty()) {
    const ssize_t count = ::pread(fd_, data.data(), data.size(), static_cast<off_t>(offset));
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) return FromErrno("cannot read " + path_.string(), errno);
    if (count == 0) return Corrupt(path_.string() + " became shorter while it was read");
    data = data.subspan(static_cast<std::size_t>(count));
    offset += static_cast<std::uint64_t>(count);
  }
  return {};
}

Status OpenFile::WriteAt(std::uint64_t offset, std::string_view data) const {
  const auto start = static_cast<off_t>(offset);
  for (std::string_view rest = data; !rest.empty();) {
    const ssize_t count = ::pwrite(fd_, rest.data(), rest.size(), static_cast<off_t>(offset));
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) return FromErrno("cannot write " + path_.string(), errno);
    rest.remove_prefix(static_cast<std::size_t>(count));
    offset += static_cast<std::uint64_t>(count);
  }
  // Only a hint: where it is not understood, the fsync does all of it.
  (void)::sync_file_range(fd_, start, static_cast<off_t>(data.size()), SYNC_FILE_RANGE_WRITE);
  return {};
}

}  // namespace trem
